// Interleaved sampling of area lights [Keller 2001]: which of the light's points a point of a gather sample
// sees. Twin: src/trace/packet/interleaved.rs.

uint point_in_list(uint index) {
    return ((5 * (index / 4)) & 15) + 16 * (index & 3);
}
