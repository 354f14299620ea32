// EWA projection of Gaussians into one pinhole camera and its vector-Jacobian product, one Gaussian per lane.
//
// Zwicker et al., "EWA Splatting", 2002; conventions and constants of gsplat 1.5.3 (ProjectionEWA3DGSFused.cu).
#pragma once

#include "simd.h"

namespace splat {

struct Camera {
  float R[9], t[3];                  // world to camera
  float stretch;                     // at least as many times as R makes any vector longer; of a rotation 1
  float fx, fy, cx, cy;              // pixels
  float x_min, x_max, y_min, y_max;  // x/z and y/z are clamped to these where the Jacobian is taken
  double inverse_R[9];               // of R, which need not be a rotation to the last bit
  float position[3];                 // of the camera in the world
};

// Inverse of a 3x3 matrix by cofactors; false where it has none.
inline bool invert(const float *m, double *inverse) {
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) {
      const int row0 = (j + 1) % 3, row1 = (j + 2) % 3, column0 = (i + 1) % 3, column1 = (i + 2) % 3;
      inverse[i * 3 + j] = static_cast<double>(m[row0 * 3 + column0]) * m[row1 * 3 + column1] -
                           static_cast<double>(m[row0 * 3 + column1]) * m[row1 * 3 + column0];
    }
  }
  const double det = m[0] * inverse[0] + m[1] * inverse[3] + m[2] * inverse[6];
  constexpr double kSmallest = 1e-12;  // of a rotation it is 1
  if (!(std::fabs(det) > kSmallest)) return false;
  for (int i = 0; i < 9; i++) inverse[i] /= det;
  return true;
}

inline bool invertible(const float *viewmat) {
  const float R[9] = {viewmat[0], viewmat[1], viewmat[2], viewmat[4], viewmat[5],
                      viewmat[6], viewmat[8], viewmat[9], viewmat[10]};
  double inverse[9];
  return invert(R, inverse);
}

// A bound of how many times R makes a vector longer: the largest sum of a row of |R R'| is no less than its square.
inline float stretch_of(const float *R) {
  double most = 0;
  for (int i = 0; i < 3; i++) {
    double sum = 0;
    for (int j = 0; j < 3; j++) {
      const float *a = R + 3 * i, *b = R + 3 * j;
      sum += std::fabs(static_cast<double>(a[0]) * b[0] + static_cast<double>(a[1]) * b[1] +
                       static_cast<double>(a[2]) * b[2]);
    }
    most = sum > most ? sum : most;
  }
  return static_cast<float>(std::sqrt(most));
}

inline Camera make_camera(const float *viewmat, const float *K, int width, int height) {
  Camera camera{};
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) camera.R[i * 3 + j] = viewmat[i * 4 + j];
    camera.t[i] = viewmat[i * 4 + 3];
  }
  camera.stretch = stretch_of(camera.R);
  invert(camera.R, camera.inverse_R);
  for (int i = 0; i < 3; i++) {
    const double *row = camera.inverse_R + 3 * i;
    camera.position[i] = static_cast<float>(-(row[0] * camera.t[0] + row[1] * camera.t[1] + row[2] * camera.t[2]));
  }
  camera.fx = K[0];
  camera.fy = K[4];
  camera.cx = K[2];
  camera.cy = K[5];
  // gsplat lets a Gaussian's centre lie 0.3 of the half field of view outside the image before it clamps.
  const float margin_x = 0.15f * width / camera.fx, margin_y = 0.15f * height / camera.fy;
  camera.x_min = -(camera.cx / camera.fx + margin_x);
  camera.x_max = (width - camera.cx) / camera.fx + margin_x;
  camera.y_min = -(camera.cy / camera.fy + margin_y);
  camera.y_max = (height - camera.cy) / camera.fy + margin_y;
  return camera;
}

// The Gaussians of one vector, in the world.
struct Shape {
  Vec mean[3];
  Vec quat[4], inverse_norm;  // normalised w, x, y, z, and 1 / the norm that it came with
  Vec scale[3];
  Vec rotation[9];
};

inline void set_rotation(Shape &s) {
  const Vec squared = s.quat[0] * s.quat[0] + s.quat[1] * s.quat[1] + s.quat[2] * s.quat[2] + s.quat[3] * s.quat[3];
  s.inverse_norm = 1.0f / sqrt(max(squared, broadcast(1e-24f)));
  for (auto &q : s.quat) q *= s.inverse_norm;
  const Vec w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  s.rotation[0] = 1.f - 2.f * (y * y + z * z);
  s.rotation[1] = 2.f * (x * y - w * z);
  s.rotation[2] = 2.f * (x * z + w * y);
  s.rotation[3] = 2.f * (x * y + w * z);
  s.rotation[4] = 1.f - 2.f * (x * x + z * z);
  s.rotation[5] = 2.f * (y * z - w * x);
  s.rotation[6] = 2.f * (x * z - w * y);
  s.rotation[7] = 2.f * (y * z + w * x);
  s.rotation[8] = 1.f - 2.f * (x * x + y * y);
}

// What projecting a Shape gives, with what its derivative needs.
struct Projection {
  Vec point[3], inverse_z;  // mean in the camera
  Vec ux, uy;               // x/z and y/z, clamped
  Mask free_x, free_y;      // where they are not
  Vec axes[9];              // columns: the Gaussian's half axes in the camera
  Vec px[3], py[3];         // the half axes in the image
  Vec normal[3];            // px x py
  Vec xx, xy, yy;           // covariance in the image, pixel^2, before the blur
  Vec xx_blur, yy_blur, det_sharp, det, inverse_det;

  Vec conic_a() const { return yy_blur * inverse_det; }
  Vec conic_b() const { return -xy * inverse_det; }
  Vec conic_c() const { return xx_blur * inverse_det; }
};

inline void point_in_camera(const Camera &c, const Vec *mean, Vec *point) {
  for (int i = 0; i < 3; i++) {
    point[i] = c.R[i * 3] * mean[0] + c.R[i * 3 + 1] * mean[1] + c.R[i * 3 + 2] * mean[2] + c.t[i];
  }
}

inline void transform_point(const Camera &c, const Shape &s, Projection &p) {
  point_in_camera(c, s.mean, p.point);
  p.inverse_z = 1.0f / p.point[2];
}

// Fills the rest of `p` after transform_point.
inline void project_covariance(const Camera &c, const Shape &s, float eps2d, Projection &p) {
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) {
      const Vec turned =
          c.R[i * 3] * s.rotation[j] + c.R[i * 3 + 1] * s.rotation[3 + j] + c.R[i * 3 + 2] * s.rotation[6 + j];
      p.axes[i * 3 + j] = turned * s.scale[j];
    }
  }
  const Vec x = p.point[0] * p.inverse_z, y = p.point[1] * p.inverse_z;
  const Vec x_min = broadcast(c.x_min), x_max = broadcast(c.x_max), y_min = broadcast(c.y_min),
            y_max = broadcast(c.y_max);
  p.free_x = both(le(x, x_max), ge(x, x_min));
  p.free_y = both(le(y, y_max), ge(y, y_min));
  p.ux = max(min(x, x_max), x_min);
  p.uy = max(min(y, y_max), y_min);
  for (int j = 0; j < 3; j++) {
    p.px[j] = c.fx * p.inverse_z * (p.axes[j] - p.ux * p.axes[6 + j]);
    p.py[j] = c.fy * p.inverse_z * (p.axes[3 + j] - p.uy * p.axes[6 + j]);
  }
  p.xx = p.px[0] * p.px[0] + p.px[1] * p.px[1] + p.px[2] * p.px[2];
  p.xy = p.px[0] * p.py[0] + p.px[1] * p.py[1] + p.px[2] * p.py[2];
  p.yy = p.py[0] * p.py[0] + p.py[1] * p.py[1] + p.py[2] * p.py[2];
  // The determinant as |px x py|^2 and a sum of positive terms: xx * yy - xy^2 cancels for long, thin Gaussians.
  for (int j = 0; j < 3; j++) {
    const int k = (j + 1) % 3, l = (j + 2) % 3;
    p.normal[j] = p.px[k] * p.py[l] - p.px[l] * p.py[k];
  }
  p.det_sharp = p.normal[0] * p.normal[0] + p.normal[1] * p.normal[1] + p.normal[2] * p.normal[2];
  p.xx_blur = p.xx + eps2d;
  p.yy_blur = p.yy + eps2d;
  p.det = p.det_sharp + eps2d * (p.xx + p.yy_blur);
  p.inverse_det = 1.0f / p.det;
}

// Mip-Splatting's opacity factor sqrt(det / det after the blur), arXiv 2311.16493 eq. 9.
inline Vec compensation(const Projection &p, float floor) {
  return sqrt(max(p.det_sharp * p.inverse_det, broadcast(floor * floor)));
}

// Gradients with respect to what a Projection gives.
struct ProjectionGradient {
  Vec mean2d[2], conic[3], depth, compensation;  // conic: a, b, c of a x^2 + 2 b x y + c y^2
};

// Gradients with respect to what it came from; R and t only where the camera's are wanted.
struct ShapeGradient {
  Vec mean[3], quat[4], scale[3];
  Vec R[9], t[3];
};

// How a projection is derived from a Shape, beyond the camera.
struct ProjectionOptions {
  float eps2d;  // pixel^2
  bool antialiased;
  float min_compensation;
};

// Gradient of the image covariance. The determinant is kept apart, as in the forward pass: through -Q v Q of the
// inverse covariance Q the gradients of long, thin Gaussians would cancel.
struct CovarianceGradient {
  Vec xx, xy, yy, det_sharp;
};

inline CovarianceGradient covariance_vjp(const Projection &p, const ProjectionGradient &v, const ProjectionOptions &o) {
  Vec v_det = -(v.conic[0] * p.conic_a() + v.conic[1] * p.conic_b() + v.conic[2] * p.conic_c()) * p.inverse_det;
  Vec v_sharp{};
  if (o.antialiased) {
    const Vec ratio = p.det_sharp * p.inverse_det;
    const Mask free = gt(ratio, broadcast(o.min_compensation * o.min_compensation));
    const Vec v_ratio = select(free, 0.5f * v.compensation / sqrt(max(ratio, broadcast(1e-12f))), Vec{});
    v_sharp = v_ratio * p.inverse_det;
    v_det -= v_sharp * ratio;
  }
  return {v.conic[2] * p.inverse_det + o.eps2d * v_det, -v.conic[1] * p.inverse_det,
          v.conic[0] * p.inverse_det + o.eps2d * v_det, v_sharp + v_det};
}

// From the gradient of the rotation matrix to that of the quaternion as given (before it was normalised).
inline void rotation_vjp(const Shape &s, const Vec *v, Vec *v_quat) {
  const Vec w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  Vec g[4];
  g[0] = 2.f * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1]));
  g[1] = 2.f * (y * (v[3] + v[1]) + z * (v[6] + v[2]) + w * (v[7] - v[5]) - 2.f * x * (v[4] + v[8]));
  g[2] = 2.f * (x * (v[3] + v[1]) + z * (v[7] + v[5]) + w * (v[2] - v[6]) - 2.f * y * (v[0] + v[8]));
  g[3] = 2.f * (x * (v[6] + v[2]) + y * (v[7] + v[5]) + w * (v[3] - v[1]) - 2.f * z * (v[0] + v[4]));
  const Vec along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
  for (int i = 0; i < 4; i++) v_quat[i] = (g[i] - along * s.quat[i]) * s.inverse_norm;
}

// Adds to `out` what one camera sends back; R and t of `out` are added to only with `camera_gradient`.
inline void project_vjp(const Camera &c, const Shape &s, const Projection &p, const ProjectionGradient &v,
                        const ProjectionOptions &options, bool camera_gradient, ShapeGradient &out) {
  const CovarianceGradient v_cov = covariance_vjp(p, v, options);
  const Vec jx = c.fx * p.inverse_z, jy = c.fy * p.inverse_z;
  Vec v_axes[9], v_jx{}, v_jy{}, v_ux{}, v_uy{};
  for (int j = 0; j < 3; j++) {
    const int k = (j + 1) % 3, l = (j + 2) % 3;
    const Vec v_normal_k = 2.f * v_cov.det_sharp * p.normal[k], v_normal_l = 2.f * v_cov.det_sharp * p.normal[l];
    const Vec v_px = 2.f * v_cov.xx * p.px[j] + v_cov.xy * p.py[j] + p.py[k] * v_normal_l - p.py[l] * v_normal_k;
    const Vec v_py = 2.f * v_cov.yy * p.py[j] + v_cov.xy * p.px[j] + p.px[l] * v_normal_k - p.px[k] * v_normal_l;
    v_axes[j] = jx * v_px;
    v_axes[3 + j] = jy * v_py;
    v_axes[6 + j] = -(p.ux * v_axes[j] + p.uy * v_axes[3 + j]);
    v_jx += v_px * (p.axes[j] - p.ux * p.axes[6 + j]);
    v_jy += v_py * (p.axes[3 + j] - p.uy * p.axes[6 + j]);
    v_ux -= v_axes[j] * p.axes[6 + j];
    v_uy -= v_axes[3 + j] * p.axes[6 + j];
  }
  v_ux = select(p.free_x, v_ux, Vec{});
  v_uy = select(p.free_y, v_uy, Vec{});
  const Vec inverse_zz = p.inverse_z * p.inverse_z;
  Vec v_point[3];
  v_point[0] = (c.fx * v.mean2d[0] + v_ux) * p.inverse_z;
  v_point[1] = (c.fy * v.mean2d[1] + v_uy) * p.inverse_z;
  v_point[2] = v.depth - (v_point[0] * p.point[0] + v_point[1] * p.point[1]) * p.inverse_z -
               (c.fx * v_jx + c.fy * v_jy) * inverse_zz;
  Vec v_rotation[9];
  for (int j = 0; j < 3; j++) {
    out.mean[j] += c.R[j] * v_point[0] + c.R[3 + j] * v_point[1] + c.R[6 + j] * v_point[2];
    for (int i = 0; i < 3; i++) {
      const Vec v_column = c.R[i] * v_axes[j] + c.R[3 + i] * v_axes[3 + j] + c.R[6 + i] * v_axes[6 + j];
      out.scale[j] += v_column * s.rotation[i * 3 + j];
      v_rotation[i * 3 + j] = v_column * s.scale[j];
    }
  }
  Vec v_quat[4];
  rotation_vjp(s, v_rotation, v_quat);
  for (int i = 0; i < 4; i++) out.quat[i] += v_quat[i];
  if (!camera_gradient) return;
  for (int i = 0; i < 3; i++) {
    out.t[i] += v_point[i];
    for (int k = 0; k < 3; k++) {
      Vec through_axes{};
      for (int j = 0; j < 3; j++) through_axes += v_axes[i * 3 + j] * s.scale[j] * s.rotation[k * 3 + j];
      out.R[i * 3 + k] += v_point[i] * s.mean[k] + through_axes;
    }
  }
}

}  // namespace splat
