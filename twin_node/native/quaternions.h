// Products and turns of quaternions w, x, y, z.
#pragma once

namespace quaternions {

// out = a * b: the rotation b followed by a. `out` is neither of them.
inline void multiply(const double *a, const double *b, double *out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// v turned by the unit quaternion q, in place.
inline void turn(const double *q, double *v) {
  double t[3], u[3];
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    t[i] = 2 * (q[1 + j] * v[k] - q[1 + k] * v[j]);
  }
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    u[i] = v[i] + q[0] * t[i] + q[1 + j] * t[k] - q[1 + k] * t[j];
  }
  for (int i = 0; i < 3; i++) v[i] = u[i];
}

}  // namespace quaternions
