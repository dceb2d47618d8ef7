// Shadow map: depth of triangles with alpha as seen from the light.

layout(location = 0) out vec2 uv;
layout(location = 1) out float alpha;
layout(location = 2) flat out uvec2 cutout_and_triangle;

void main() {
    CutoutCorner c = push.corners.at[gl_VertexIndex];
    uv = c.uv;
    alpha = c.alpha;
    cutout_and_triangle = uvec2(c.cutout, gl_VertexIndex / 3);
    gl_Position = push.faces.at[push.face].clip_from_mesh * vec4(c.position, 1.0);
}
