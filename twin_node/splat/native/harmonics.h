// Real spherical harmonics up to degree 3, in the order and with the signs of 3D Gaussian splatting files.
//
// Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013, section 3 and appendix A2.
#pragma once

#include "simd.h"

namespace splat {

constexpr int kMaxBases = 16;

struct Direction {
  Vec x, y, z;
};

// Values of the (degree + 1)^2 bases in unit direction d.
inline void harmonics(int degree, const Direction &d, Vec *bases) {
  bases[0] = broadcast(0.28209479177387814f);
  if (degree < 1) return;
  constexpr float k1 = 0.48860251190292f;
  bases[1] = -k1 * d.y;
  bases[2] = k1 * d.z;
  bases[3] = -k1 * d.x;
  if (degree < 2) return;
  const Vec zz = d.z * d.z, cos2 = d.x * d.x - d.y * d.y, sin2 = 2.f * d.x * d.y;
  const Vec band1 = -1.092548430592079f * d.z;
  bases[4] = 0.5462742152960395f * sin2;
  bases[5] = band1 * d.y;
  bases[6] = 0.9461746957575601f * zz - 0.3153915652525201f;
  bases[7] = band1 * d.x;
  bases[8] = 0.5462742152960395f * cos2;
  if (degree < 3) return;
  const Vec band2 = 0.4570457994644658f - 2.285228997322329f * zz, band3 = 1.445305721320277f * d.z;
  const Vec cos3 = d.x * cos2 - d.y * sin2, sin3 = d.x * sin2 + d.y * cos2;
  bases[9] = -0.5900435899266435f * sin3;
  bases[10] = band3 * sin2;
  bases[11] = band2 * d.y;
  bases[12] = d.z * (1.865881662950577f * zz - 1.119528997770346f);
  bases[13] = band2 * d.x;
  bases[14] = band3 * cos2;
  bases[15] = -0.5900435899266435f * cos3;
}

// Gradient with respect to d of sum_k v[k] * bases[k], d taken as free (not on the sphere).
inline Direction harmonics_vjp(int degree, const Direction &d, const Vec *v) {
  Direction g{Vec{}, Vec{}, Vec{}};
  if (degree < 1) return g;
  constexpr float k1 = 0.48860251190292f;
  g.x = -k1 * v[3];
  g.y = -k1 * v[1];
  g.z = k1 * v[2];
  if (degree < 2) return g;
  const Vec zz = d.z * d.z, cos2 = d.x * d.x - d.y * d.y, sin2 = 2.f * d.x * d.y;
  constexpr float k2 = 1.092548430592079f;
  g.x -= k2 * d.z * v[7];
  g.y -= k2 * d.z * v[5];
  g.z += 2.f * 0.9461746957575601f * d.z * v[6] - k2 * (d.x * v[7] + d.y * v[5]);
  Vec v_cos2 = 0.5462742152960395f * v[8], v_sin2 = 0.5462742152960395f * v[4];
  if (degree >= 3) {
    const Vec band2 = 0.4570457994644658f - 2.285228997322329f * zz, band3 = 1.445305721320277f * d.z;
    g.x += band2 * v[13];
    g.y += band2 * v[11];
    g.z += (3.f * 1.865881662950577f * zz - 1.119528997770346f) * v[12];
    g.z -= 2.f * 2.285228997322329f * d.z * (d.x * v[13] + d.y * v[11]);
    g.z += 1.445305721320277f * (cos2 * v[14] + sin2 * v[10]);
    const Vec v_cos3 = -0.5900435899266435f * v[15], v_sin3 = -0.5900435899266435f * v[9];
    g.x += v_cos3 * cos2 + v_sin3 * sin2;
    g.y += v_sin3 * cos2 - v_cos3 * sin2;
    v_cos2 += band3 * v[14] + v_cos3 * d.x + v_sin3 * d.y;
    v_sin2 += band3 * v[10] - v_cos3 * d.y + v_sin3 * d.x;
  }
  g.x += 2.f * (d.x * v_cos2 + d.y * v_sin2);
  g.y += 2.f * (d.x * v_sin2 - d.y * v_cos2);
  return g;
}

}  // namespace splat
