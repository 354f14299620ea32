// Normal equations of the motion of nodes: how the pixels of the Gaussians that they carry would have to move.
//
// 12 parameters per node: translation (m), rotation (rad), strain xx, yy, zz, xy, xz, yz. Observations are the optical
// flow under a Gaussian and, where depth is measured, the depth at the flow's end.
#pragma once

#include <algorithm>
#include <cmath>

#include "camera.h"
#include "interface.h"
#include "velocities.h"

namespace model {

constexpr int kMotions = 12, kObserved = 3;

// Colour of the image [H, W, 3] at continuous pixel coordinates (whole numbers at centres), black beyond its edge.
inline void sample(const MotionRequest &r, double x, double y, float *out) {
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  const float fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
  out[0] = out[1] = out[2] = 0.f;
  for (int corner = 0; corner < 4; corner++) {
    const int column = x0 + (corner & 1), row = y0 + (corner >> 1);
    if (column < 0 || column >= r.width || row < 0 || row >= r.height) continue;
    const float weight = ((corner & 1) ? fx : 1.f - fx) * ((corner >> 1) ? fy : 1.f - fy);
    for (int k = 0; k < 3; k++) out[k] += weight * r.image[3 * (static_cast<int64_t>(row) * r.width + column) + k];
  }
}

// Depth measured in the pixel next to continuous coordinates; 0 where none is.
inline double depth_at(const MotionRequest &r, double x, double y) {
  const int64_t column = std::lround(x), row = std::lround(y);
  if (r.depth == nullptr || column < 0 || column >= r.width || row < 0 || row >= r.height) return 0;
  return r.depth[row * r.width + column];
}

struct FlowObservation {
  double error[kObserved], weight, depth_scale;
};

// What is observed at a pixel that shows a Gaussian.
inline FlowObservation observe_flow(const MotionRequest &r, int64_t column, int64_t row) {
  const int64_t pixel = row * r.width + column;
  const float *flow = r.flow + 2 * pixel, *shown = r.shown + 4 * pixel;
  const double x = column + flow[0], y = row + flow[1], measured = depth_at(r, x, y);
  float arrived[3];
  sample(r, x, y, arrived);
  double square = 0;
  for (int k = 0; k < 3; k++) square += (arrived[k] - shown[k]) * (arrived[k] - shown[k]) / 3;
  const bool known = measured > 0 && shown[3] > 0;
  FlowObservation out{{flow[0], flow[1], 0}, 0, known ? 1 / (r.depth_share * std::max<double>(shown[3], 0.05)) : 0};
  out.error[2] = known ? (measured - shown[3]) * out.depth_scale : 0;
  const double *e = out.error, length = std::sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
  out.weight = std::exp(-square / (r.colour_sigma * r.colour_sigma)) * r.huber_px / std::max(length, r.huber_px);
  return out;
}

// Rows of the Jacobian [3][12]: pixels (u, v, scaled depth) per parameter, for a point at `arm` from its node.
inline void jacobian(const Pinhole &c, const double *point, const double *arm, double depth_scale,
                     double (*J)[kMotions]) {
  double x[3];
  c.to_camera(point, x);
  for (int axis = 0; axis < 3; axis++) {
    J[0][axis] = c.fx / x[2] * (c.R[axis] - x[0] / x[2] * c.R[6 + axis]);
    J[1][axis] = c.fy / x[2] * (c.R[3 + axis] - x[1] / x[2] * c.R[6 + axis]);
    J[2][axis] = depth_scale * c.R[6 + axis];
  }
  for (int i = 0; i < kObserved; i++) {
    const double *p = J[i];
    J[i][3] = arm[1] * p[2] - arm[2] * p[1];
    J[i][4] = arm[2] * p[0] - arm[0] * p[2];
    J[i][5] = arm[0] * p[1] - arm[1] * p[0];
    for (int axis = 0; axis < 3; axis++) J[i][6 + axis] = p[axis] * arm[axis];
    J[i][9] = p[0] * arm[1] + p[1] * arm[0];
    J[i][10] = p[0] * arm[2] + p[2] * arm[0];
    J[i][11] = p[1] * arm[2] + p[2] * arm[1];
  }
}

// Adds one view's observations to the equations of the nodes.
inline void gather_motion(const MotionRequest &r) {
  const Pinhole camera(r.viewmat, r.K, r.width, r.height);
  for (int64_t i = 0; i < r.count; i++) {
    const double *mean = r.means + 3 * i;
    const Found found = camera.find(mean);
    if (!found.inside || !r.counted[found.at]) continue;
    if (!(std::fabs(found.depth - r.shown[4 * found.at + 3]) < r.shown_share * found.depth)) continue;
    const FlowObservation seen = observe_flow(r, found.column, found.row);
    double J[kObserved][kMotions];
    jacobian(camera, mean, r.arms + 3 * i, seen.depth_scale, J);
    const double weight = seen.weight * r.opacities[i] * r.scale;
    const int64_t node = r.carriers[i];
    double *H = r.H + node * kMotions * kMotions, *g = r.g + node * kMotions, squares = 0;
    for (int k = 0; k < kObserved; k++) {
      squares += seen.error[k] * seen.error[k];
      for (int a = 0; a < kMotions; a++) {
        const double weighted = weight * J[k][a];
        g[a] += weighted * seen.error[k];
        for (int b = 0; b < kMotions; b++) H[a * kMotions + b] += weighted * J[k][b];
      }
    }
    r.squares[node] += weight * squares;
    r.weights[node] += seen.weight;
  }
}

// The most likely motion of each node in its first N parameters; what is not seen stays as it was foretold.
template <int N>
void solve_motion(const SolveRequest &r) {
  for (int64_t n = 0; n < r.count; n++) {
    const double *H = r.H + kMotions * kMotions * n, *g = r.g + kMotions * n;
    double *solution = r.solution + N * n, *variances = r.variances + N * n;
    r.cost[n] = r.squares[n];
    for (int k = 0; k < N; k++) solution[k] = 0, variances[k] = r.sigmas[k] * r.sigmas[k];
    if (!(r.weights[n] > 0)) continue;
    double known[N][N], L[N][N], R[N][N];
    for (int i = 0; i < N; i++) {
      for (int j = 0; j < N; j++) known[i][j] = H[kMotions * i + j] + (i == j ? 1 / variances[i] : 0);
    }
    decompose(known, L);
    invert(L, R);
    std::fill_n(variances, N, 0.);
    for (int i = 0; i < N; i++) {
      double along = 0;
      for (int j = 0; j <= i; j++) along += R[i][j] * g[j];
      for (int j = 0; j <= i; j++) solution[j] += R[i][j] * along, variances[j] += R[i][j] * R[i][j];
    }
    for (int k = 0; k < N; k++) r.cost[n] -= g[k] * solution[k];
  }
}

inline void solve_motions(const SolveRequest &r) {
  r.size == kTwist ? solve_motion<kTwist>(r) : solve_motion<kMotions>(r);
}

}  // namespace model
