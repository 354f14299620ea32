// At which depth newborns lie where none is measured: `birth_depths.agreed` in one go.
#pragma once

#include <limits>
#include <vector>

#include "camera.h"
#include "interface.h"

namespace model {

constexpr int kBlock = 2;                              // side of the smallest block of pixels that a newborn stands for
constexpr double kCloser = 0.95, kUnknownShare = 0.9;  // of the background's depth
constexpr double kNearest = 0.15, kFarthest = 0.97;    // shares of it that are tried
constexpr double kBeforeIt = 0.995, kHalf = 0.5;
constexpr int kStride = 2, kReach = 6;  // every how many pixels the rendering is looked at, and how many steps each way

struct Block {
  float error;      // summed over its pixels
  int row, column;  // of the pixel above and left of its middle
  int side;
  float rgb[3];
  double ray[3];
};

struct Lying {
  double depth;
  bool on_background;
};

inline double median_of(std::vector<double> all) {
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return all.size() % 2 ? *middle : (*std::max_element(all.begin(), middle) + *middle) / 2;
}

inline bool occluded(const BirthView &view, const Found &found, double occlusion) {
  return found.depth > view.far[found.at] * (1 + occlusion);
}

inline void point_at(const BirthView &view, const double *ray, double depth, double *point) {
  for (int k = 0; k < 3; k++) point[k] = view.T_base_cam[4 * k + 3] + ray[k] * depth;
}

// The depths of some blocks of one view; the other views have a say in them.
class BirthDepths {
 public:
  BirthDepths(const BirthRequest &request, int index, const std::vector<Pinhole> &cameras,
              const std::vector<Block> &blocks)
      : rules_(*request.rules), views_(request.views), count_(request.count), index_(index), v_(views_[index]),
        cameras_(cameras), blocks_(blocks) {}

  std::vector<Lying> run() {
    std::vector<Lying> lying;
    if (blocks_.empty()) return lying;
    spread_levels();
    find_votes();
    find_moving();
    for (size_t i = 0; i < blocks_.size(); i++) lying.push_back(choose(i));
    return lying;
  }

 private:
  int64_t middle(const Block &block) const { return static_cast<int64_t>(block.row) * v_.width + block.column; }

  double far(size_t i) const { return v_.far[middle(blocks_[i])]; }

  double *votes_of(size_t i) { return votes_.data() + i * shares_.size(); }

  // Shares of the background's depth that are tried.
  void spread_levels() {
    const double step = (kFarthest - kNearest) / std::max(rules_.samples - 1, 1);
    for (int k = 0; k < rules_.samples; k++) shares_.push_back(kNearest + step * k);
  }

  // How much the other views speak for every block at every depth.
  void find_votes() {
    votes_.assign(blocks_.size() * shares_.size(), 0.);
    for (size_t i = 0; i < blocks_.size(); i++) {
      const Block &block = blocks_[i];
      for (size_t k = 0; k < shares_.size(); k++) {
        const double depth = far(i) * shares_[k];
        double point[3], vote = 0;
        point_at(v_, block.ray, depth, point);
        for (int other = 0; other < count_; other++) {
          if (other != index_) vote += support(other, point, block, kHalf * block.side / v_.K[0] * depth);
        }
        votes_of(i)[k] = vote;
      }
    }
  }

  // How much one view speaks for a point that looks like `block` and has `radius`.
  double support(int other, const double *point, const Block &block, double radius) const {
    const BirthView &view = views_[other];
    const Found found = cameras_[other].find(point);
    const double most_px = rules_.huge * kHalf * block.side;
    const bool huge = found.depth > -radius &&
                      radius * cameras_[other].fx > most_px * std::max(found.depth, kNearestSeen);
    if (huge) return -rules_.refuted;
    if (!found.inside || occluded(view, found, rules_.occlusion) || !view.usable[found.at]) return 0;
    if (!view.near_moving[found.at]) return -rules_.refuted;
    float apart = 0.f;
    for (int k = 0; k < 3; k++) apart += std::fabs(view.rgb[3 * found.at + k] - block.rgb[k]);
    const double share = apart / 3 / rules_.colour_sigma;
    return kHalf + std::exp(-share * share);
  }

  bool moves(int64_t at) const {
    const double depth = v_.shown[4 * at + 3];
    return depth > 0 && depth < kCloser * v_.far[at];
  }

  // The median depth of what the rendering shows to move, negative without.
  void find_moving() {
    std::vector<double> all;
    for (int64_t at = 0; at < static_cast<int64_t>(v_.width) * v_.height; at++) {
      if (moves(at)) all.push_back(v_.shown[4 * at + 3]);
    }
    moving_ = all.empty() ? -1 : median_of(all);
  }

  // How much a pixel says of another, from their distance in pixels and their colours.
  double affinity(int rows, int columns, const float *a, const float *b) const {
    double square = 0;
    for (int k = 0; k < 3; k++) square += (static_cast<double>(a[k]) - b[k]) * (static_cast<double>(a[k]) - b[k]);
    const double unlike = square / 3 / (rules_.colour_sigma * rules_.colour_sigma);
    const double apart = (rows * rows + columns * columns) / (rules_.neighbour_px * rules_.neighbour_px);
    return std::exp(-0.5 * (apart + unlike));
  }

  // The median depth of the moving things around a block that look like it, else of all.
  double known_depth(const Block &block, double far) const {
    if (moving_ < 0) return kUnknownShare * far;
    struct Near {
      double depth, weight;
    };
    std::vector<Near> around;
    double total = 0;
    for (int i = -kReach; i <= kReach; i++) {
      for (int k = -kReach; k <= kReach; k++) {
        const int row = block.row + kStride * i, column = block.column + kStride * k;
        if (row < 0 || row >= v_.height || column < 0 || column >= v_.width) continue;
        const int64_t at = static_cast<int64_t>(row) * v_.width + column;
        if (!moves(at)) continue;
        around.push_back({v_.shown[4 * at + 3], affinity(kStride * i, kStride * k, v_.shown + 4 * at, block.rgb)});
        total += around.back().weight;
      }
    }
    if (total < rules_.fewest) return std::min(moving_, far);
    std::stable_sort(around.begin(), around.end(), [](const Near &a, const Near &b) { return a.depth < b.depth; });
    double passed = 0;
    for (const Near &one : around) {
      passed += one.weight;
      if (passed >= kHalf * total) return std::min(one.depth, far);
    }
    return std::min(around.back().depth, far);
  }

  // The depth of a block with the best support, its neighbours' included; the background's where none is left standing.
  Lying choose(size_t i) {
    const Block &block = blocks_[i];
    std::vector<double> shared(shares_.size(), 0.);
    double total = 0;
    for (size_t j = 0; j < blocks_.size(); j++) {
      const Block &other = blocks_[j];
      const double weight = affinity(other.row - block.row, other.column - block.column, other.rgb, block.rgb);
      total += weight;
      for (size_t k = 0; k < shares_.size(); k++) shared[k] += weight * std::max(votes_of(j)[k], rules_.dissent);
    }
    const double known = known_depth(block, far(i));
    size_t best = 0;
    double most = -std::numeric_limits<double>::infinity();
    for (size_t k = 0; k < shares_.size(); k++) {
      const double own = votes_of(i)[k], vote = own < -kHalf * rules_.refuted ? own : shared[k] / total;
      const double score = vote - rules_.locality * std::fabs(std::log(far(i) * shares_[k] / known));
      if (score > most) {
        most = score;
        best = k;
      }
    }
    const bool on = most < -kHalf * rules_.refuted || !v_.near_moving[middle(block)];
    return {far(i) * (on ? kBeforeIt : shares_[settled(votes_of(i), best)]), on};
  }

  // The best level, or the middle of those that no other view looks at where it is one of them.
  size_t settled(const double *votes, size_t best) const {
    if (count_ == 1 || votes[best] != 0) return best;
    const auto unseen = std::count(votes, votes + shares_.size(), 0.);
    std::ptrdiff_t passed = 0;
    size_t level = 0;
    while ((passed += votes[level] == 0) < (unseen + 1) / 2) level++;
    return level;
  }

  const BirthRules &rules_;
  const BirthView *views_;
  const int count_, index_;
  const BirthView &v_;
  const std::vector<Pinhole> &cameras_;
  const std::vector<Block> &blocks_;
  std::vector<double> shares_, votes_;  // [L] and [blocks, L]
  double moving_ = -1;                  // m
};

}  // namespace model
