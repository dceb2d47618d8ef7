// Shadow map: depth of opaque triangles as seen from the light.

void main() {
    uint at = 3 * gl_VertexIndex;
    vec3 position = vec3(push.positions.at[at], push.positions.at[at + 1], push.positions.at[at + 2]);
    gl_Position = push.faces.at[push.face].clip_from_mesh * vec4(position, 1.0);
}
