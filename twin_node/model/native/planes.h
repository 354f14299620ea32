// Images as one plane per channel, and how they differ.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace model {

constexpr int kSampled = 4, kLeastSample = 50;  // every how many pixels medians look at one, and of how many at least
constexpr double kLoud = 3.;                    // so many times the usual noise cannot be it
constexpr double kNoiseShare = 0.05;            // of each new image in what is known of its camera's noise

using Gains = std::array<float, 3>;

struct Planes {
  const float *data;
  int64_t pixels;
  float operator()(int channel, int64_t at) const { return data[channel * pixels + at]; }
};

// Largest difference over the channels of image and other * gain.
inline float difference(const Planes &image, const Planes &other, const Gains &gain, int64_t at) {
  float most = 0.f;
  for (int k = 0; k < 3; k++) {
    const float apart = std::fabs(image(k, at) - other(k, at) * gain[k]);
    most = most < apart ? apart : most;
  }
  return most;
}

// The upper median of values, which are put in another order.
inline float middle(std::vector<float> &values) {
  const auto half = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), half, values.end());
  return *half;
}

// Takes another image's noise into what is known of a camera's, 0 until there is any. The first, if it is far more than
// is `usual`, counts whole, but no more than `most`: what is once held for moving is not measured any more.
inline void take_noise(double noise, double usual, double most, double &known) {
  if (known <= 0 && noise > kLoud * usual) {
    known = std::min(noise, most);
  } else {
    const double before = known > 0 ? known : usual;
    known = before + kNoiseShare * (noise - before);
  }
}

}  // namespace model
