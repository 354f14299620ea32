// What crosses the plain C boundary: these structs are mirrored field by field in library.py.
#pragma once

#include <cstdint>

namespace splat {

constexpr int32_t kInterfaceVersion = 13;

enum Status : int32_t {
  kOk = 0,  // 1: `boundary::kOutOfMemory`
  kTooManyIntersections = 2,
  kBadFocalLength = 3,
  kSingularView = 4,
  kNonFinite = 100,  // + the index of the argument, as non_finite_argument counts them
};

enum DepthMode : int32_t { kNoDepth = 0, kAccumulatedDepth = 1, kExpectedDepth = 2 };

constexpr int kColumns = 14;  // of a row of a store's values: mean, quat, log scale, logit, colour

// B batches of C cameras, N Gaussians each. A batch stride of 0 shares the array among all batches.
struct Request {
  int32_t batches, cameras, gaussians, width, height;
  int32_t color_channels;  // D of plain colours, 3 with spherical harmonics, 0 where only depth is rendered
  int32_t sh_bases;        // K coefficients per channel; 0 for plain colours
  int32_t sh_degree;
  int32_t colors_per_camera;  // 1: colors are [B, C, N, ...]
  int32_t depth_mode;
  int32_t antialiased;
  int32_t threads;
  float near_plane, far_plane, radius_clip, eps2d, max_alpha, min_compensation;
  int64_t means_stride, quats_stride, scales_stride, opacities_stride, colors_stride;  // floats from batch to batch
  const float *means;                                                                  // [B, N, 3]
  const float *quats;                                                                  // [B, N, 4] w, x, y, z
  const float *scales;                                                                 // [B, N, 3]
  const float *opacities;                                                              // [B, N]
  const float *colors;        // [B, (C,) N, D] or [B, (C,) N, K, 3]
  const float *viewmats;      // [B, C, 4, 4]
  const float *Ks;            // [B, C, 3, 3]
  const float *backgrounds;   // [B, C, channels] or null
  const float *backdrop;      // [B, C, H, W, channels] or null: what stands behind all, pixel by pixel
  float *seen;                // the same: renders before their backdrop, which gradients are then by
  const uint8_t *pixel_mask;  // [B, C, H, W] or null
  float *renders;             // [B, C, H, W, channels]
  float *alphas;              // [B, C, H, W, 1]
  int32_t *radii;             // [B, C, N, 2]
  float *means2d;             // [B, C, N, 2]
  float *depths;              // [B, C, N]
};

// Gradients of the loss. The outputs have the shapes (and batch strides) of the inputs and must come zeroed.
struct Gradients {
  const float *v_renders;  // [B, C, H, W, channels]
  const float *v_alphas;   // [B, C, H, W, 1] or null
  float *v_means;
  float *v_quats;
  float *v_scales;
  float *v_opacities;
  float *v_colors;    // null where only depth is rendered
  float *v_viewmats;  // [B, C, 4, 4] or null
  int32_t first_row;       // Gaussians before it get no gradient
  const uint8_t *learns;   // [N] those that get one, or null: all from first_row on
};

// One view of a scene that is held to what a camera sees.
struct MissRequest {
  Request scene;         // one camera; colours end with a feature that is zero; accumulated depth where it is measured
  Gradients gradients;   // of `pull` and `pull_alpha`; added to
  const float *target;   // [H, W, colours - 1]
  const float *depth;    // [H, W] 0 where unknown, or null
  const float *surface;  // [H, W] depth of what stands behind all, or null
  float outlier;         // error that pulls no harder when it grows
  float depth_gain;      // what a relative error of depth counts in errors of colour
  float nearest;         // smallest depth that is divided by
  float *pull;           // [H, W, channels]
  float *pull_alpha;     // [H, W]
};

struct LossRequest {
  int32_t images, height, width;
  int32_t channels;  // floats per pixel in render: 3, or 4 with the depth last
  int32_t threads;
  float l1, ssim, depth_weight;
  const float *render;        // [images, H, W, channels]
  const float *target;        // [images, H, W, 3]
  const float *weights;       // [images, H, W] or null; a pixel counts where it is positive
  const float *target_depth;  // [images, H, W] or null; 0 where unknown
  float *gradient;            // [images, H, W, channels], comes zeroed
  double *loss;               // [1]
};

// Steps of Adam on the last `learned` Gaussians of a scene whose first `standing` stay as they are.
struct DescentRequest {
  Request scene;        // batches are times of one camera each; plain colours and accumulated depth
  Gradients gradients;  // v_renders is loss.gradient, v_alphas null
  LossRequest loss;     // of what is seen
  int32_t standing, learned, steps;
  float smallest_log_scale;
  float *means, *quats, *scales, *opacities, *colors;  // those of the scene; the learned rows are written
  const int64_t *rows;                                 // [learned] of the store that the next five are
  float *values, *moment1, *moment2;                   // [store, 14] mean, quat, log scale, logit, rgb
  int64_t *steps_taken;                                // [store]
  const float *ceilings;                               // [store] largest log scale
  const float *rates;                                  // [learned, 14]
  int64_t carriages;                                   // K
  const float *turns, *shifts, *products;              // [B, K, 3, 3], [B, K, 3], [B, K, 4, 4]
  const int64_t *carriers;                             // [learned] which of the K carries each
  float first_decay, second_decay;                     // of Adam's moments
  int64_t *refused;                                    // [1]
  double *losses;                                      // [steps] before each of them
};

// Gaussians [count] in the frames of their carriers, wanted where those are at several times.
struct PlaceRequest {
  int64_t count, times, nodes;
  int32_t threads;
  const int64_t *rows;                  // [count] of the store that the next two are; null: all of it, in order
  const float *values;                  // [store, 14] mean, quat, log scale, logit, rgb
  const int64_t *carriers;              // [store] nodes, -1 for none
  const double *positions, *rotations;  // [times, nodes, 3], [times, nodes, 4]
  float *means, *quats;                 // [times, count, 3], [times, count, 4]
  float *scales, *opacities, *rgb;      // [count, 3], [count], [count, 3]
};

}  // namespace splat
