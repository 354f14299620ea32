// How deep the ground is that one camera sees, and where depth tells it from what stands on it: `GroundDepth` in one go.
#pragma once

#include <algorithm>
#include <cstddef>

#include "interface.h"
#include "planes.h"
#include "regions.h"

namespace model {

constexpr double kNearM = 0.01;
constexpr double kMostFirstNoise = 0.05;  // of depth, m at 1 m
constexpr double kSigmaOfDifference = 1.48 / 1.4142135623730951;
static const Kernel kCross = {{-1, 0}, {0, 1}, {1, 0}};  // a pixel and the four beside it
static const Kernel kSquare = {{-1, 1}, {0, 1}, {1, 1}};  // and the eight around it

// What is remembered of one camera's depth, and what the newest image tells of it.
class GroundDepth {
 public:
  explicit GroundDepth(const MaskRequest &request)
      : r_(request), p_(*request.rules), pixels_(static_cast<int64_t>(request.width) * request.height) {}

  // Takes in how much what is free differs from the depth that was measured there before.
  void measure_noise() {
    if (r_.measured == nullptr) return;
    const float near = static_cast<float>(kNearM);
    std::vector<float> sample;
    for (int row = 0; row < r_.height; row += kSampled) {
      for (int column = 0; column < r_.width; column += kSampled) {
        const int64_t at = static_cast<int64_t>(row) * r_.width + column;
        const float now = r_.measured[at], before = r_.measured_last[at];
        if (!r_.seen[at] || r_.mask[at] || !(now > near) || !(before > near)) continue;
        sample.push_back(std::fabs(now - before) / (before * before));
      }
    }
    if (sample.size() <= kLeastSample) return;
    take_noise(kSigmaOfDifference * middle(sample), 0., kMostFirstNoise, *r_.depth_noise);
  }

  // Takes what is measured where a pixel is seen for the first time.
  void meet(int64_t at) {
    if (r_.measured == nullptr) return;
    r_.depth[at] = r_.measured[at];
    r_.telling[at] = r_.measured[at] > 0 ? 1.f : 0.f;
  }

  // How long each pixel has not been measured, and where ground is so often that the lack of it tells.
  void look() {
    tells_.resize(pixels_);
    lost_.resize(pixels_);
    const float *measured = r_.measured;
    if (measured == nullptr) {
      look([](int64_t) -> uint8_t { return 0; }, 0.f);
    } else {
      look([measured](int64_t at) -> uint8_t { return measured[at] > 0; }, static_cast<float>(p_.learning_rate));
    }
  }

  // Where a measured surface stands in front of the background's.
  Mask stands_before() const {
    const float *measured = r_.measured;
    if (measured == nullptr) return Mask(pixels_, 0);
    const Mask nearer = nearer_than_ground([measured](int64_t at) { return measured[at]; });
    return dilated(eroded(nearer, r_.width, r_.height, kCross).data(), r_.width, r_.height, kCross);
  }

  // The same, and where a surface does or did when something was measured last, there or at a pixel beside.
  void find_in_front() {
    const float *measured = r_.measured, *last = r_.measured_last;
    in_front_ = stands_before();
    const auto newest = [=](int64_t at) { return measured != nullptr && measured[at] > 0 ? measured[at] : last[at]; };
    rim_ = dilated(nearer_than_ground(newest).data(), r_.width, r_.height, kSquare);
  }

  bool in_front(int64_t at) const { return in_front_[at]; }
  bool is_rim(int64_t at) const { return rim_[at]; }
  bool tells(int64_t at) const { return tells_[at]; }
  const uint8_t *lost() const { return lost_.data(); }
  bool is_known(int64_t at) const { return r_.depth[at] > 0; }

  // Whether ground is known there, and something has been measured since it looks as it does.
  bool is_measured(int64_t at) const { return is_known(at) && r_.blind_ns[at] < r_.still_ns[at]; }

  // Whether any depth is known: else colours alone must tell ground from somebody who stands there.
  bool is_told() const {
    return std::any_of(r_.depth, r_.depth + pixels_, [](float depth) { return depth > 0; });
  }

  // Where what stands in front of the background's surface has come, and its rim there, whose pixels hardly change.
  Mask come_in_front() const {
    Mask come(pixels_, 0);
    if (r_.measured == nullptr) return come;
    const Slack slack = this->slack();
    const float *measured = r_.measured, *last = r_.measured_last;
    const uint8_t *in_front = in_front_.data();
    uint8_t *out = come.data();
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      // What only comes nearer may be the background itself.
      const float now = measured[at], before = last[at];
      const uint8_t is_told = (before > 0) & (now > 0), has_come = now < before - slack(before);
      out[at] = in_front[at] & ((is_told ^ 1) | has_come);
    }
    come = dilated(come.data(), r_.width, r_.height, kCross);
    for (int64_t at = 0; at < end; at++) come[at] &= in_front_[at];
    return come;
  }

  // Knows nothing of ground that something measured has left, and that is not: a mat, a shining floor.
  void forget(int64_t at) { r_.depth[at] = r_.telling[at] = 0.f; }

  // Draws the ground towards what is measured, by shares `rates`, above 0 where a pixel is free.
  void learn(const std::vector<float> &rates) {
    if (r_.measured == nullptr) return;
    const float learning_rate = static_cast<float>(p_.learning_rate);
    const Slack slack = this->slack();
    const float *__restrict__ measured = r_.measured, *__restrict__ rate = rates.data();
    float *__restrict__ ground = r_.depth, *__restrict__ last = r_.measured_last;
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      const float now = measured[at], depth = ground[at], before = last[at], free = rate[at];
      const float behind = before < now ? before : now, at_least = free < learning_rate ? learning_rate : free;
      const float share = depth == 0.f ? (free > 0 ? 1.f : 0.f) : (now > depth ? at_least : free);
      const float drawn = depth + share * (now - depth);
      const float next = (depth > 0) & (behind > depth + slack(depth)) ? behind : drawn;
      ground[at] = now > 0 ? next : depth;
      last[at] = now > 0 ? now : before;
    }
  }

 private:
  // Smallest change that counts of a depth that this camera measures.
  struct Slack {
    float share, near, noise, most;
    float operator()(float depth) const {
      const float least = share * depth + near, growing = noise * depth;
      const float noisy = (growing < most ? growing : most) * depth;
      return least < noisy ? noisy : least;
    }
  };
  Slack slack() const {
    return {static_cast<float>(p_.depth_levels), static_cast<float>(kNearM),
            static_cast<float>(p_.noise_sigmas * *r_.depth_noise), static_cast<float>(p_.most_noise)};
  }

  template <class Measured>
  void look(const Measured &is_measured, float rate) {
    const float least = static_cast<float>(p_.telling), lost_ns = static_cast<float>(p_.lost_ns);
    const float elapsed_ns = r_.elapsed_ns;
    const uint8_t speaks = !r_.is_silent;
    const uint8_t *__restrict__ seen = r_.seen, *__restrict__ mask = r_.mask;
    float *__restrict__ blind_ns = r_.blind_ns, *__restrict__ telling = r_.telling;
    uint8_t *__restrict__ tells = tells_.data(), *__restrict__ lost = lost_.data();
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      const uint8_t is = is_measured(at), is_free = seen[at] & (mask[at] ^ 1);
      const float longer_ns = blind_ns[at] + elapsed_ns, blind = is != 0 ? 0.f : longer_ns, told = telling[at];
      const float drawn = told + rate * ((is != 0 ? 1.f : 0.f) - told), share = is_free != 0 ? drawn : told;
      blind_ns[at] = blind;
      telling[at] = share;
      tells[at] = speaks & (share >= least);
      lost[at] = speaks & (share >= least) & (blind > lost_ns);
    }
  }

  template <class Depth>
  Mask nearer_than_ground(const Depth &depth_at) const {
    Mask nearer(pixels_);
    const Slack slack = this->slack();
    const float *__restrict__ ground = r_.depth;
    const uint8_t *__restrict__ seen = r_.seen;
    uint8_t *__restrict__ out = nearer.data();
    for (int64_t at = 0, end = pixels_; at < end; at++) {
      const float depth = depth_at(at), behind = ground[at];
      out[at] = seen[at] & (depth > 0) & (behind > 0) & (depth < behind - slack(behind));
    }
    return nearer;
  }

  const MaskRequest &r_;
  const MaskRules &p_;
  const int64_t pixels_;
  Mask in_front_, rim_;
  Mask tells_, lost_;  // where ground is measured, and of these where nothing has been for long
};

}  // namespace model
