// What crosses the boundary of the library: plain structs, mirrored in `model/kernels.py`.
#pragma once

#include <cstdint>

namespace model {

constexpr int32_t kInterfaceVersion = 1;

enum Status : int32_t { kOk = 0, kOutOfMemory = 1 };

// What counts as change; see `MovingMaskParameters`. Levels are those of 8-bit images.
struct MaskRules {
  double change_sigmas, change_levels, settle_ns, smallest_area, shadow_darkest, reflection_brightest;
  double ground_certainty, ground_likelihood, learning_rate, depth_levels;
  int32_t rings;    // of uncovered ground that are found per image
  int32_t closing;  // radius of the kernel that closes gaps, pixels
  const uint8_t *kernel;  // [2 closing + 1, 2 closing + 1]
};

// One camera's next image, and all that is remembered of the ones before; that is brought up to date in place.
struct MaskRequest {
  int32_t width, height;
  float elapsed_ns;             // since the image before
  const MaskRules *rules;
  const uint8_t *smooth;        // [H, W, 3] the image, slightly smoothed
  const uint8_t *seen;          // [H, W] valid, and off the robot
  const float *reference, *last;  // [3, H, W] the image of one baseline ago, and the one before
  const float *measured;        // [H, W] m, 0 where unknown, or null
  float *image;                 // [3, H, W] written: `smooth` as planes
  float *background, *depth, *still_ns;  // [3, H, W], [H, W] or null, [H, W]
  uint8_t *known, *trusted, *confirmed, *mask;  // [H, W]
  double *ground, *moving;      // [4096] how often each colour was free ground, and a moving thing
  double *sigma;                // [1] noise of the images, levels
};

struct MaskRequests {
  int32_t count, threads;
  const MaskRequest *cameras;  // [count]
};

}  // namespace model
