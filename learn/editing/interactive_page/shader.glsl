#version 300 es
// One part of the object: radiance by normal, before the background.
precision highp float;
precision highp sampler2D;
uniform sampler2D photo, behind, geometry, residual, first, second;
uniform int region, unchanged, ground;
uniform float blend, detail, split, contrast, gain;
uniform vec3 groundColor;
out vec4 color;

vec3 linear(vec3 c) {
  return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
}
vec3 srgb(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}
vec3 lookUp(sampler2D map, vec2 p) {
  float size = float(textureSize(map, 0).x);
  return texture(map, ((p * 0.5 + 0.5) * (size - 1.0) + 0.5) / size).rgb;
}
void main() {
  ivec2 size = textureSize(photo, 0);
  ivec2 at = ivec2(int(gl_FragCoord.x), size.y - 1 - int(gl_FragCoord.y));
  vec4 place = texelFetch(geometry, at, 0);  // point of the disk, coverage, region
  if (place.w != float(region)) discard;
  vec4 before = texelFetch(photo, at, 0);  // alpha: opacity
  float alpha = before.a;
  if (gl_FragCoord.x > split * float(size.x)) { color = before; return; }
  float coverage = unchanged == 1 ? 0.0 : place.z;
  vec4 around = texelFetch(behind, at, 0);  // alpha: the object's share of the color
  vec3 back = coverage > 0.0 ? around.rgb : before.rgb;
  if (ground == 1) { back = groundColor; coverage = place.z; alpha = 1.0; }
  vec3 object = vec3(0.0);
  if (coverage > 0.0) {
    object = unchanged == 1 ? linear(before.rgb) : lookUp(first, place.xy);
    if (blend > 0.0) object = mix(object, lookUp(second, place.xy), blend);
    if (detail > 0.0 && unchanged == 0)
      object *= exp((texelFetch(residual, at, 0).rgb * 2.0 - 1.0) * contrast * detail);
    if (unchanged == 0) object *= gain;
  }
  float share = ground == 1 ? coverage : around.a;
  if (share < 1.0) object = mix(linear(back), object, share);
  color = vec4(coverage > 0.0 ? srgb(object) : back, alpha);
}
