// What the graphics card does for the view; each part begins with its name.
//: head
precision highp float;
precision highp sampler3D;
uniform vec3 right, up, back, target;
uniform vec2 lens;
uniform float away;
vec4 seen(vec3 point) {
  vec3 q = point - target;
  float ahead = away - dot(q, back), near = max(away - 4.0, 0.02), far = away + 4.0;
  float depth = (ahead * (far + near) - 2.0 * far * near) / (far - near);
  return vec4(lens * vec2(dot(q, right), dot(q, up)), depth, ahead);
}
// What is cut away lies beyond all cuts, to the sides where there are any.
uniform vec3 cut, side;
bool removed(vec3 point, vec3 but) {
  return all(greaterThan((point - cut) * side + 9.0 * (1.0 - abs(side)) + 9.0 * but, vec3(0)));
}
// How solid the body is about a point; less than nothing beyond its voxels.
uniform sampler3D greys;
uniform vec3 greyLow, greySize;
float grey(vec3 point, float blur) {
  vec3 place = (point - greyLow) / greySize;
  if (any(lessThan(place, vec3(0))) || any(greaterThan(place, vec3(1)))) return -1.0;
  return textureLod(greys, place.zyx, blur).r;
}
//: body-vertex
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 value;
uniform vec3 low, size;
uniform int walls;
out vec3 point, outward;
out vec2 width;
flat out float cap;
void main() {
  point = low + size * place;
  outward = normal;
  width = value;
  cap = gl_VertexID >= walls ? 1.0 : 0.0;
  gl_Position = seen(point);
}
//: body-fragment
in vec3 point, outward;
in vec2 width;
flat in float cap;
uniform bool pores, cutting, coloured, shaded;
uniform float alpha, limit, pixel, voxel;
uniform sampler2D scale;
out vec4 colour;
// How much light comes from before the surface: fills there, the farther the coarser.
float open(vec3 normal) {
  float closed = 0.0;
  for (int i = 0; i < 4; i++) {
    float off = 1.5 * exp2(float(i));
    float found = grey(point + normal * off * voxel, float(i));
    closed += found < 0.0 ? 0.0 : (gl_FrontFacing ? found : 1.0 - found) * (0.36 - 0.06 * float(i));
  }
  return 1.0 - min(closed, 0.8);
}
void main() {
  if (cutting && removed(point, vec3(0))) discard;
  bool hidden = gl_FrontFacing == pores;
  vec3 normal = normalize(outward) * (gl_FrontFacing ? 1.0 : -1.0);
  vec3 plain = pores ? vec3(0.42, 0.62, 0.74) : mix(vec3(0.85, 0.66, 0.44), vec3(0.91, 0.80, 0.62), cap);
  float known = pores ? width.y : width.x;
  vec3 base = coloured && known > 0.0 ? texture(scale, vec2((known * 65535.0 - 1.0) / 65534.0, 0.5)).rgb : plain;
  if (coloured && known == 0.0) base = vec3(0.75);
  if (known > 0.0 && known < limit && fract((gl_FragCoord.x + gl_FragCoord.y) / (9.0 * pixel)) < 0.36)
    base = vec3(0.87, 0.05, 0.40);
  if (hidden) base *= pores ? 0.72 : 0.45;
  vec3 n = vec3(dot(normal, right), dot(normal, up), dot(normal, back));
  float light = 0.50 + 0.14 * n.y + 0.10 * normal.z;
  light += 0.34 * max(dot(n, normalize(vec3(-0.5, 0.75, 0.85))), 0.0) + 0.14 * max(n.z, 0.0);
  if (shaded) light *= open(normal);
  vec3 lit = base * light;
  float depth = clamp(0.5 - 0.5 * dot(point - target, back), 0.0, 1.0);
  colour = vec4(mix(lit, vec3(0.95, 0.94, 0.93), 0.22 * depth), 1.0) * alpha;
}
//: slice-vertex
uniform vec3 from, along, across;
out vec3 point;
void main() {
  point = from + along * float(gl_VertexID & 1) + across * float(gl_VertexID >> 1);
  gl_Position = seen(point);
}
//: slice-fragment
in vec3 point;
uniform bool cutting;
uniform vec3 own;
out vec4 colour;
void main() {
  float fill = grey(point, 0.0);
  if (fill < 0.0 || (cutting && (fill < 0.5 || !removed(point, own)))) discard;
  colour = vec4(vec3(0.10 + 0.66 * fill), 1.0);
}
//: line-vertex
layout(location = 0) in vec3 begin;
layout(location = 1) in vec3 end;
uniform vec2 pixels;
uniform float thick;
void main() {
  vec4 a = seen(begin), b = seen(end);
  vec2 way = normalize((b.xy / b.w - a.xy / a.w) * pixels + 1e-9);
  vec4 at = gl_VertexID < 2 ? a : b;
  at.xy += vec2(-way.y, way.x) * thick * (float(gl_VertexID & 1) - 0.5) * 2.0 / pixels * at.w;
  gl_Position = at;
}
//: line-fragment
out vec4 colour;
void main() { colour = vec4(0.36, 0.34, 0.32, 1.0); }
