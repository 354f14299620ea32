// Finds NaN and infinity in the arguments before anything is computed from them.
#pragma once

#include <cstddef>

#include "simd.h"

namespace splat {

struct Floats {
  const float *data;  // may be null
  int64_t count;
};

inline bool all_finite(const Floats &floats) {
  constexpr int kSums = 4;  // none has to wait for the one before
  Vec zero[kSums] = {};
  float rest = 0.f;
  int64_t i = 0;
  // x - x is 0 for every finite x and NaN for every other
  for (; i + kSums * kLanes <= floats.count; i += kSums * kLanes) {
    for (int k = 0; k < kSums; k++) {
      const Vec x = load(floats.data + i + k * kLanes);
      zero[k] += x - x;
    }
  }
  for (; i < floats.count; i++) rest += floats.data[i] - floats.data[i];
  return sum(zero[0] + zero[1] + (zero[2] + zero[3])) + rest == 0.f;
}

// Index of the first argument that holds a value that is not finite, or -1.
template <size_t kArguments>
inline int first_non_finite(const Floats (&arguments)[kArguments]) {
  for (size_t i = 0; i < kArguments; i++) {
    if (arguments[i].data != nullptr && !all_finite(arguments[i])) return static_cast<int>(i);
  }
  return -1;
}

}  // namespace splat
