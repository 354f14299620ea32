// Which pixels of one camera show something that moves or has moved: `CameraMask.update` in one go.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "colours.h"
#include "ground_depth.h"
#include "interface.h"
#include "planes.h"
#include "regions.h"

namespace model {

constexpr float kDark = 4.f;                    // levels added to both sides of a ratio: black tells nothing
constexpr double kLeastNoise = 0.5, kUsualNoise = 1.45, kMostFirst = 20., kSigmaOfMedian = 1.48;
constexpr double kQuiet = 0.7, kAlike = 0.6;
constexpr double kFading = 0.98;
constexpr int kAround = 2;  // pixels that a ring of ground looks at, each way

// One camera's update: its stages in the order in which they are called.
class MaskUpdate {
 public:
  explicit MaskUpdate(const MaskRequest &request)
      : r_(request),
        p_(*request.rules),
        pixels_(static_cast<int64_t>(request.width) * request.height),
        image_{request.image, pixels_},
        background_{request.background, pixels_},
        depth_(request),
        closing_(kernel_of(p_.kernel, p_.closing)),
        uncovered_(pixels_, 0),
        by_depth_(pixels_, 0),
        bared_(pixels_, 0),
        difference_(pixels_),
        plain_(3 * pixels_),
        bin_(pixels_) {}

  void run() {
    depth_.measure_noise();
    unpack();
    gain_ = gain(background_, [&](int64_t at) { return r_.seen[at] && !r_.mask[at] && r_.known[at]; });
    expose();
    meet();
    depth_.look();
    find_settled();
    threshold_ = static_cast<float>(std::max(p_.change_levels, p_.change_sigmas * *r_.sigma));
    compare();
    depth_.find_in_front();
    Mask mask = moving();
    hold(mask);
    doubt(mask);
    uncover(mask);
    learn(mask);
  }

 private:
  // The image as it would be at the background's exposure.
  float plain(int channel, int64_t at) const { return plain_[channel * pixels_ + at]; }

  void unpack() {
    for (int64_t at = 0; at < pixels_; at++) {
      for (int k = 0; k < 3; k++) r_.image[k * pixels_ + at] = r_.smooth[3 * at + k];
    }
  }

  void expose() {
    for (int k = 0; k < 3; k++) {
      for (int64_t at = k * pixels_; at < (k + 1) * pixels_; at++) plain_[at] = r_.image[at] / gain_[k];
    }
    for (int64_t at = 0; at < pixels_; at++) {
      bin_[at] = static_cast<uint16_t>(bin_of([&](int k) { return plain(k, at); }));
    }
  }

  template <class Free>
  Gains gain(const Planes &reference, const Free &free) const {
    std::vector<float> ratios[3];
    for (int row = 0; row < r_.height; row += kSampled) {
      for (int column = 0; column < r_.width; column += kSampled) {
        const int64_t at = static_cast<int64_t>(row) * r_.width + column;
        if (!free(at)) continue;
        for (int k = 0; k < 3; k++) ratios[k].push_back((image_(k, at) + kDark) / (reference(k, at) + kDark));
      }
    }
    if (ratios[0].size() < kLeastSample) return {1.f, 1.f, 1.f};
    return {middle(ratios[0]), middle(ratios[1]), middle(ratios[2])};
  }

  // Takes pixels that are seen for the first time as the scene at rest, unless they touch what moves, and not where
  // something is before all that the arm has let through: that moves, and behind it is what it was.
  void meet() {
    std::vector<int64_t> fresh;
    for (int64_t at = 0; at < pixels_; at++) {
      if (r_.seen[at] && !r_.known[at]) fresh.push_back(at);
    }
    if (fresh.empty()) return;
    const Mask around = dilated(r_.mask, r_.width, r_.height, closing_), before = depth_.stands_before();
    for (const int64_t at : fresh) {
      if (before[at]) continue;
      r_.known[at] = 1;
      for (int k = 0; k < 3; k++) r_.background[k * pixels_ + at] = plain(k, at);
      depth_.meet(at);
      if (!around[at]) continue;
      r_.trusted[at] = 0;
      r_.mask[at] = 1;
    }
  }

  // Pixels that look as they did one baseline ago and have been still since; measures the noise on the way.
  void find_settled() {
    const Planes reference{r_.reference, pixels_}, last{r_.last, pixels_};
    const auto free = [&](int64_t at) { return r_.seen[at] && !r_.mask[at]; };
    const Gains gains = gain(reference, free);
    const float quiet = static_cast<float>(kQuiet * std::max(p_.change_levels, p_.change_sigmas * *r_.sigma));
    const float settle_ns = static_cast<float>(p_.settle_ns);
    settled_.resize(pixels_);
    const Planes image = image_;
    const float elapsed_ns = r_.elapsed_ns;
    float *__restrict__ still_ns = r_.still_ns;
    uint8_t *__restrict__ settled = settled_.data();
    const Gains same{1.f, 1.f, 1.f};
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      const float change = difference(image, reference, gains, at), moved = difference(image, last, same, at);
      const float longer_ns = still_ns[at] + elapsed_ns, for_ns = moved < quiet ? longer_ns : 0.f;
      still_ns[at] = for_ns;
      settled[at] = (for_ns > settle_ns) & (change < quiet);
    }
    if (elapsed_ns <= 0) return;  // the first image, and itself
    std::vector<float> sample;
    for (int row = 0; row < r_.height; row += kSampled) {
      for (int column = 0; column < r_.width; column += kSampled) {
        const int64_t at = static_cast<int64_t>(row) * r_.width + column;
        if (free(at)) sample.push_back(difference(image_, reference, gains, at));
      }
    }
    if (sample.size() > kLeastSample) {
      const double noise = std::max(kLeastNoise, kSigmaOfMedian * middle(sample));
      take_noise(noise, kUsualNoise, kMostFirst, *r_.sigma);
    }
  }

  // What differs from the background by more than a shadow or a glow.
  void compare() {
    const float darkest = static_cast<float>(p_.shadow_darkest);
    const float brightest = static_cast<float>(p_.reflection_brightest);
    const float alike = static_cast<float>(kAlike * threshold_);
    for (int64_t at = 0; at < pixels_; at++) {
      float expected[3], both = 0.f, square = 0.f, residual = 0.f, apart = 0.f;
      for (int k = 0; k < 3; k++) {
        expected[k] = background_(k, at) * gain_[k];
        both += image_(k, at) * expected[k];
        square += expected[k] * expected[k];
        apart = std::max(apart, std::fabs(image_(k, at) - expected[k]));
      }
      const float ratio = both / std::max(square, 1.f);
      for (int k = 0; k < 3; k++) residual = std::max(residual, std::fabs(image_(k, at) - ratio * expected[k]));
      const bool lit = (ratio > darkest) & (ratio < brightest) & (residual < alike);
      difference_[at] = lit ? 0.f : apart;
    }
  }

  Mask moving() const {
    std::vector<float> evidence(pixels_);
    const float *apart = difference_.data();
    for (int64_t at = 0; at < pixels_; at++) {
      const float difference = apart[at];
      evidence[at] = (r_.trusted[at] & r_.seen[at]) != 0 ? difference : 0.f;
    }
    const Mask strong = strong_regions(evidence, r_.width, r_.height, 0.5f * threshold_, threshold_,
                                       p_.smallest_area * static_cast<double>(pixels_));
    Mask out = closed(strong, r_.width, r_.height, closing_);
    for (int64_t at = 0; at < pixels_; at++) out[at] |= depth_.in_front(at);
    return out;
  }

  bool like_ground(int64_t at) const { return difference_[at] < 0.5f * threshold_; }

  // What moved stays, until it looks like ground and no depth is missing, and so do the pixels around it, but for those
  // that the arm hides: they tell of nothing. So does ground, never seen, that it encloses.
  void hold(Mask &mask) const {
    Mask ground(pixels_), hole(pixels_);
    const uint8_t *__restrict__ trusted = r_.trusted, *__restrict__ held = r_.mask, *__restrict__ seen = r_.seen;
    const uint8_t *__restrict__ confirmed = r_.confirmed, *__restrict__ lost = depth_.lost();
    const float *__restrict__ apart = difference_.data(), likeness = 0.5f * threshold_;
    const int64_t end = pixels_;
    const auto over = [end](Mask &to, const auto &value) {
      uint8_t *__restrict__ out = to.data();
      for (int64_t at = 0; at < end; at++) out[at] = value(out[at], at);
    };
    over(ground, [=](uint8_t, int64_t at) {
      return (trusted[at] & (apart[at] < likeness) & (lost[at] ^ 1)) | (seen[at] ^ 1);
    });
    ground = eroded(ground, r_.width, r_.height, kSquare);
    over(mask, [=, other = ground.data()](uint8_t is, int64_t at) { return is | (held[at] & (other[at] ^ 1)); });
    const Mask outline = closed(mask, r_.width, r_.height, closing_);
    const Mask whole = filled(outline, r_.width, r_.height);
    const uint8_t *__restrict__ full = whole.data(), *__restrict__ edge = outline.data();
    over(hole, [=](uint8_t, int64_t at) { return full[at] & (edge[at] ^ 1); });
    const Mask inside = dilated(hole.data(), r_.width, r_.height, closing_);
    over(mask, [=, near = inside.data()](uint8_t is, int64_t at) {
      return (is | (near[at] & full[at] & (confirmed[at] ^ 1))) & seen[at];
    });
  }

  // The background may show the very thing where one begins to be seen that looks like it, unless it is known to be
  // ground since another one left it, or what is seen there has just come. Where no depth is known nothing else would
  // notice that it is a thing: there the former does not count.
  void doubt(const Mask &mask) const {
    const Mask come = depth_.come_in_front();
    const uint8_t *now = mask.data(), *arrives = come.data(), *held = r_.mask, *confirmed = r_.confirmed;
    const float *apart = difference_.data(), *ground = r_.depth, likeness = 0.5f * threshold_;
    uint8_t *trusted = r_.trusted;
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      const uint8_t is_ground = confirmed[at] & (ground[at] > 0), alike = apart[at] < likeness;
      const uint8_t begins = now[at] & (held[at] ^ 1) & (is_ground ^ 1);
      trusted[at] &= (begins & alike & (arrives[at] ^ 1)) ^ 1;
    }
  }

  // Counts the colours of free ground and of moving things.
  void count_colours(const Mask &mask) const {
    for (int i = 0; i < kBins; i++) {
      r_.ground[i] *= kFading;
      r_.moving[i] *= kFading;
    }
    for (int64_t at = 0; at < pixels_; at++) {
      if (r_.seen[at] && !mask[at]) r_.ground[bin_[at]] += 1;
      if (r_.confirmed[at] && r_.trusted[at] && difference_[at] > threshold_) r_.moving[bin_[at]] += 1;
    }
  }

  // Where a line of `size` pixels is looked at beyond its ends: mirrored, the end itself not repeated.
  static int mirrored(int at, int size) {
    if (size == 1) return 0;
    while (at < 0 || at >= size) at = at < 0 ? -at : 2 * size - 2 - at;
    return at;
  }

  // Whether a settled pixel continues the ground around it, of which `known` is what is known. `shares` of colours, less
  // than 0 while nothing is known of them. Where it is not measured, colours alone must tell it from somebody who
  // stands there.
  bool continues(int64_t at, const Mask &known, const std::vector<float> &shares) const {
    const bool told = by_depth_[at];
    const float share = shares[bin_[at]] >= 0 ? shares[bin_[at]] : told ? 0.f : 0.5f;
    const int row = static_cast<int>(at / r_.width), column = static_cast<int>(at % r_.width);
    constexpr int kSide = 2 * kAround + 1;
    float sums[3] = {0.f, 0.f, 0.f}, count = 0.f;
    int columns[kSide];
    for (int x = 0; x < kSide; x++) columns[x] = mirrored(column - kAround + x, r_.width);
    for (int y = row - kAround; y <= row + kAround; y++) {
      const int64_t first = static_cast<int64_t>(mirrored(y, r_.height)) * r_.width;
      for (const int x : columns) {
        const int64_t near = first + x;
        if (!known[near]) continue;
        count += 1.f;
        for (int k = 0; k < 3; k++) sums[k] += plain(k, near);
      }
    }
    if (!(count / (kSide * kSide) > 0.2f)) return false;
    float rough = 0.f, was_rough = 0.f;
    for (int k = 0; k < 3; k++) {
      const float ground = sums[k] / count;
      rough = std::max(rough, std::fabs(plain(k, at) - ground));
      was_rough = std::max(was_rough, std::fabs(background_(k, at) - ground));
    }
    const bool better = rough < kQuiet * was_rough, likely = share > p_.ground_likelihood;
    const bool fits = likely && was_rough > 2 * threshold_ && better;
    if (!(rough < kAlike * threshold_ || fits || share > p_.ground_certainty)) return false;
    if (told) return true;
    if (!r_.trusted[at]) return likely;
    return better && shares[bin_[at]] >= shares[bin_of([&](int k) { return background_(k, at); })];
  }

  // Whether a background that is doubted is seen, its depth known, and nearly all pixels around show one that is not.
  bool is_among_ground(int64_t at) const {
    if (r_.trusted[at] || !like_ground(at) || !depth_.is_known(at)) return false;
    const int row = static_cast<int>(at / r_.width), column = static_cast<int>(at % r_.width);
    int ground = 0, all = 0;
    for (int y = std::max(row - kAround, 0); y <= std::min(row + kAround, r_.height - 1); y++) {
      for (int x = std::max(column - kAround, 0); x <= std::min(column + kAround, r_.width - 1); x++) {
        const int64_t near = static_cast<int64_t>(y) * r_.width + x;
        ground += r_.seen[near] && r_.trusted[near] && like_ground(near);
        all++;
      }
    }
    return ground >= p_.ground_around * all;
  }

  // Whether depth is known of most of the free ground around a pixel.
  bool is_amid_known_depth(int64_t at, const Mask &free) const {
    const int row = static_cast<int>(at / r_.width), column = static_cast<int>(at % r_.width);
    int known = 0, all = 0;
    for (int y = std::max(row - kAround, 0); y <= std::min(row + kAround, r_.height - 1); y++) {
      for (int x = std::max(column - kAround, 0); x <= std::min(column + kAround, r_.width - 1); x++) {
        const int64_t near = static_cast<int64_t>(y) * r_.width + x;
        known += free[near] && depth_.is_known(near);
        all += free[near];
      }
    }
    return known >= p_.telling * all;
  }

  // Settled pixels that a thing, there from the start, has moved off: ground that was never seen before.
  void uncover(const Mask &mask) {
    count_colours(mask);
    std::vector<int64_t> open, found;
    Mask known(pixels_);
    const uint8_t *seen = r_.seen, *now = mask.data();
    uint8_t *is_known = known.data();
    for (int64_t at = 0, end = pixels_; at < end; at++) is_known[at] = seen[at] & (now[at] ^ 1);
    const Mask free = known;
    for (int64_t at = 0; at < pixels_; at++) {
      if (!settled_[at] || !mask[at] || depth_.is_rim(at)) continue;
      const bool measured = depth_.is_measured(at), bares = depth_.tells(at) && !measured && !is_amid_known_depth(at, free);
      bared_[at] = bares;
      by_depth_[at] = measured || bares;
      if (depth_.tells(at) && !by_depth_[at]) continue;
      if (is_among_ground(at)) {
        known[at] = uncovered_[at] = 1;
      } else {
        open.push_back(at);
      }
    }
    const bool told = depth_.is_told();
    if (!told) *r_.bared *= kFading;
    if (open.empty()) return;
    const std::vector<float> shares = ground_shares(r_.ground, r_.moving, -1.f);
    for (int ring = 0; ring < p_.rings; ring++) {
      found.clear();
      std::vector<int64_t> left;
      for (const int64_t at : open) (continues(at, known, shares) ? found : left).push_back(at);
      for (const int64_t at : found) {
        known[at] = 1;
        const bool differs = difference_[at] > threshold_;
        uncovered_[at] = differs || !r_.trusted[at];
        if (!told && differs && r_.trusted[at]) *r_.bared += 1;
      }
      open.swap(left);
    }
  }

  // Takes what has been found into what is remembered.
  void learn(const Mask &mask) {
    for (int64_t at = 0; at < pixels_; at++) {
      if (uncovered_[at] && bared_[at]) depth_.forget(at);
    }
    std::vector<float> rates(pixels_);
    const float learning_rate = static_cast<float>(p_.learning_rate);
    const uint8_t *__restrict__ now = mask.data(), *__restrict__ uncovered = uncovered_.data();
    const uint8_t *__restrict__ seen = r_.seen;
    uint8_t *__restrict__ confirmed = r_.confirmed, *__restrict__ trusted = r_.trusted, *__restrict__ held = r_.mask;
    float *__restrict__ rate = rates.data();
    const int64_t end = pixels_;
#pragma omp simd
    for (int64_t at = 0; at < end; at++) {
      const uint8_t is_uncovered = uncovered[at], moves = now[at] & (is_uncovered ^ 1);
      confirmed[at] |= (held[at] & (now[at] ^ 1) & seen[at]) | is_uncovered;
      trusted[at] |= is_uncovered;
      held[at] = moves;
      rate[at] = (seen[at] & (moves ^ 1)) != 0 ? (is_uncovered != 0 ? 1.f : learning_rate) : 0.f;
    }
    for (int k = 0; k < 3; k++) {
      float *__restrict__ background = r_.background + k * pixels_;
      const float *__restrict__ seen_there = plain_.data() + k * pixels_;
      for (int64_t at = 0; at < end; at++) background[at] += rate[at] * (seen_there[at] - background[at]);
    }
    depth_.learn(rates);
  }

  const MaskRequest &r_;
  const MaskRules &p_;
  const int64_t pixels_;
  const Planes image_, background_;
  GroundDepth depth_;
  const Kernel closing_;
  Gains gain_{};
  float threshold_ = 0;
  Mask settled_, uncovered_;
  Mask by_depth_, bared_;  // where depth tells ground; of these, where a thing has left ground that is not measured
  std::vector<float> difference_, plain_;
  std::vector<uint16_t> bin_;  // of each pixel's colour
};

}  // namespace model
