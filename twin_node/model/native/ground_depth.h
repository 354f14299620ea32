// How deep the ground is that one camera sees, and where depth tells it from what stands on it: `GroundDepth` in one go.
#pragma once

#include <algorithm>
#include <cstddef>

#include "interface.h"
#include "planes.h"
#include "regions.h"

namespace model {

constexpr double kNearM = 0.01;
static const Kernel kCross = {{-1, 0}, {0, 1}, {1, 0}};  // a pixel and the four beside it

// What is remembered of one camera's depth, and what the newest image tells of it.
class GroundDepth {
 public:
  explicit GroundDepth(const MaskRequest &request)
      : r_(request), p_(*request.rules), pixels_(static_cast<int64_t>(request.width) * request.height) {}

  // Takes what is measured where a pixel is seen for the first time.
  void meet(int64_t at) {
    if (r_.measured == nullptr) return;
    r_.depth[at] = r_.measured[at];
    r_.telling[at] = r_.measured[at] > 0 ? 1.f : 0.f;
  }

  // How long each pixel has not been measured, and where ground is so often that the lack of it tells.
  void look() {
    const float rate = static_cast<float>(p_.learning_rate), least = static_cast<float>(p_.telling);
    const float lost_ns = static_cast<float>(p_.lost_ns);
    tells_.resize(pixels_);
    lost_.resize(pixels_);
    for (int64_t at = 0; at < pixels_; at++) {
      const bool is_measured = r_.measured != nullptr && r_.measured[at] > 0, is_free = r_.seen[at] && !r_.mask[at];
      r_.blind_ns[at] = is_measured ? 0.f : r_.blind_ns[at] + r_.elapsed_ns;
      if (r_.measured != nullptr && is_free) r_.telling[at] += rate * ((is_measured ? 1.f : 0.f) - r_.telling[at]);
      tells_[at] = !r_.is_silent && r_.telling[at] >= least;
      lost_[at] = tells_[at] && r_.blind_ns[at] > lost_ns;
    }
  }

  // Where a measured surface stands in front of the background's, and where one did when something was measured last.
  void find_in_front() {
    in_front_.assign(pixels_, 0);
    if (r_.measured != nullptr) in_front_ = before_ground([&](int64_t at) { return r_.measured[at]; });
    was_in_front_ = before_ground([&](int64_t at) {
      return r_.measured != nullptr && r_.measured[at] > 0 ? r_.measured[at] : r_.measured_last[at];
    });
  }

  bool in_front(int64_t at) const { return in_front_[at]; }
  bool was_in_front(int64_t at) const { return was_in_front_[at]; }
  bool tells(int64_t at) const { return tells_[at]; }
  const uint8_t *lost() const { return lost_.data(); }
  bool is_known(int64_t at) const { return r_.depth[at] > 0; }

  // Whether ground is known there, and something has been measured since it looks as it does.
  bool is_measured(int64_t at) const { return is_known(at) && r_.blind_ns[at] < r_.still_ns[at]; }

  // Whether any depth is known: else colours alone must tell ground from somebody who stands there.
  bool is_told() const {
    return std::any_of(r_.depth, r_.depth + pixels_, [](float depth) { return depth > 0; });
  }

  // Where what stands in front of the background's surface has come, and the rim of that, whose pixels hardly change.
  Mask come_in_front() const {
    Mask come(pixels_, 0);
    if (r_.measured == nullptr) return come;
    for (int64_t at = 0; at < pixels_; at++) come[at] = in_front_[at] && has_come(at);
    return dilated(come.data(), r_.width, r_.height, kCross);
  }

  // Knows nothing of ground that something measured has left, and that is not: a mat, a shining floor.
  void forget(int64_t at) { r_.depth[at] = r_.telling[at] = 0.f; }

  // Draws the ground towards what is measured, by shares `rates`, above 0 where a pixel is free.
  void learn(const std::vector<float> &rates) {
    const float learning_rate = static_cast<float>(p_.learning_rate);
    for (int64_t at = 0; at < pixels_ && r_.measured != nullptr; at++) {
      const float measured = r_.measured[at], depth = r_.depth[at], behind = std::min(measured, r_.measured_last[at]);
      if (!(measured > 0)) continue;
      r_.measured_last[at] = measured;
      if (depth > 0 && behind > depth * static_cast<float>(1 + p_.depth_levels) + static_cast<float>(kNearM)) {
        r_.depth[at] = behind;
        continue;
      }
      const float known = measured > depth ? std::max(rates[at], learning_rate) : rates[at];
      const float share = depth == 0.f ? (rates[at] > 0 ? 1.f : 0.f) : known;
      r_.depth[at] += share * (measured - depth);
    }
  }

 private:
  // Whether one depth is clearly less than another, both known.
  bool is_before(float depth, float other) const {
    return depth < other * static_cast<float>(1 - p_.depth_levels) - static_cast<float>(kNearM);
  }

  // Whether what is measured was not there in the image before: what only comes nearer may be the background itself.
  bool has_come(int64_t at) const {
    const float last = r_.measured_last[at];
    return !(last > 0 && r_.measured[at] > 0) || is_before(r_.measured[at], last);
  }

  template <class Depth>
  Mask before_ground(const Depth &depth_at) const {
    Mask near(pixels_);
    for (int64_t at = 0; at < pixels_; at++) {
      const float depth = depth_at(at);
      near[at] = r_.seen[at] && depth > 0 && is_known(at) && is_before(depth, r_.depth[at]);
    }
    return dilated(eroded(near, r_.width, r_.height, kCross).data(), r_.width, r_.height, kCross);
  }

  const MaskRequest &r_;
  const MaskRules &p_;
  const int64_t pixels_;
  Mask in_front_, was_in_front_;
  Mask tells_, lost_;  // where ground is measured, and of these where nothing has been for long
};

}  // namespace model
