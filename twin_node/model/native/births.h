// New Gaussians where a rendering does not explain an image: `find_births_plainly` in one go.
#pragma once

#include <limits>
#include <vector>

#include "camera.h"
#include "interface.h"

namespace model {

constexpr int kBlock = 2;                               // side of the block of pixels that one newborn stands for
constexpr int kCells = 8;                               // that depths are pooled in, each way
constexpr double kCloser = 0.95, kUnknownShare = 0.9;   // of the background's depth
constexpr double kNearest = 0.15, kFarthest = 0.97;     // shares of it that are tried
constexpr double kBeforeIt = 0.995, kHalf = 0.5;

// One view's births; `others` are the views that have a say in their depth.
class ViewBirths {
 public:
  ViewBirths(const BirthRequest &request, int index)
      : rules_(*request.rules), views_(request.views), count_(request.count), index_(index), v_(request.views[index]) {
    for (int i = 0; i < count_; i++) {
      cameras_.emplace_back(views_[i].viewmat, views_[i].K, views_[i].width, views_[i].height);
    }
  }

  void run() {
    find_blocks();
    pool_depths();
    int64_t born = 0;
    for (const Block &block : blocks_) born += bear(block, born);
    *v_.born = born;
  }

 private:
  struct Block {
    float error;
    int row, column;  // its first pixel
  };

  int64_t pixel(int row, int column) const { return static_cast<int64_t>(row) * v_.width + column; }

  float error(int64_t at) const {
    const bool replaced = !v_.stale[at] || v_.alpha[at] < rules_.solid;
    if (!v_.active[at] || !(v_.surprise[at] > kHalf * rules_.threshold) || !replaced) return 0.f;
    float most = 0.f;
    for (int k = 0; k < 3; k++) most = std::max(most, std::fabs(v_.rgb[3 * at + k] - v_.shown[4 * at + k]));
    return most;
  }

  // The worst blocks, at most as many as may be born.
  void find_blocks() {
    for (int row = 0; row + kBlock <= v_.height; row += kBlock) {
      for (int column = 0; column + kBlock <= v_.width; column += kBlock) {
        const int64_t a = pixel(row, column), b = pixel(row + 1, column);
        const float mean = (error(a) + error(a + 1) + error(b) + error(b + 1)) * 0.25f;
        if (mean > rules_.threshold) blocks_.push_back({mean, row, column});
      }
    }
    std::stable_sort(blocks_.begin(), blocks_.end(), [](const Block &a, const Block &b) { return a.error > b.error; });
    if (static_cast<int64_t>(blocks_.size()) > rules_.quota) blocks_.resize(rules_.quota);
  }

  int cell(int row, int column) const { return row * kCells / v_.height * kCells + column * kCells / v_.width; }

  // Mean depth of the moving things that the rendering shows, cell by cell of the image; elsewhere the median of all.
  void pool_depths() {
    std::vector<double> sums(kCells * kCells, 0.), all;
    std::vector<int64_t> counts(kCells * kCells, 0);
    for (int row = 0; row < v_.height && !blocks_.empty(); row++) {
      for (int column = 0; column < v_.width; column++) {
        const int64_t at = pixel(row, column);
        const double depth = v_.shown[4 * at + 3];
        if (!(depth > 0 && depth < kCloser * v_.far[at])) continue;
        sums[cell(row, column)] += depth;
        counts[cell(row, column)]++;
        all.push_back(depth);
      }
    }
    if (all.empty()) return;
    const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
    std::nth_element(all.begin(), middle, all.end());
    const double lower = all.size() % 2 ? *middle : *std::max_element(all.begin(), middle);
    pooled_.resize(kCells * kCells);
    for (int i = 0; i < kCells * kCells; i++) {
      pooled_[i] = counts[i] > 0 ? sums[i] / static_cast<double>(counts[i]) : (lower + *middle) / 2;
    }
  }

  double known_depth(const Block &block, double far) const {
    return pooled_.empty() ? kUnknownShare * far : std::min(pooled_[cell(block.row, block.column)], far);
  }

  static bool occluded(const BirthView &view, const Found &found, double occlusion) {
    return found.depth > view.far[found.at] * (1 + occlusion);
  }

  // How much one view speaks for a point of colour `rgb` and `radius`.
  double support(int other, const double *point, double radius, const float *rgb) const {
    const BirthView &view = views_[other];
    const Found found = cameras_[other].find(point);
    const bool huge = found.depth > -radius &&
                      radius * cameras_[other].focal() > rules_.huge_px * std::max(found.depth, kNearestSeen);
    if (huge) return -rules_.refuted;
    if (!found.inside || occluded(view, found, rules_.occlusion) || !view.usable[found.at]) return 0;
    if (!view.near_moving[found.at]) return -rules_.refuted;
    float apart = 0.f;
    for (int k = 0; k < 3; k++) apart += std::fabs(view.rgb[3 * found.at + k] - rgb[k]);
    const double share = apart / 3 / rules_.colour_sigma;
    return kHalf + std::exp(-share * share);
  }

  // Whether another view shows the background unchanged at a point.
  bool contradicted(const double *point) const {
    for (int other = 0; other < count_; other++) {
      if (other == index_) continue;
      const BirthView &view = views_[other];
      const Found found = cameras_[other].find(point);
      if (!found.inside || occluded(view, found, rules_.occlusion) || !view.usable[found.at]) continue;
      if (view.surprise[found.at] < kHalf * rules_.threshold) return true;
    }
    return false;
  }

  void point_at(const double *ray, double depth, double *point) const {
    for (int k = 0; k < 3; k++) point[k] = v_.T_base_cam[4 * k + 3] + ray[k] * depth;
  }

  struct Depth {
    double value;
    bool on_background;
  };

  Depth measured(int64_t at, double far) const {
    const double depth = v_.measured[at] > 0 ? v_.measured[at] : far;
    return {depth, depth > (1 - rules_.same_depth) * far};
  }

  // The depth along a ray with the best support of the other views; the background's where none is left standing.
  Depth agreed(const Block &block, const double *ray, double far, const float *rgb) const {
    const double known = known_depth(block, far);
    double best = 0, most = -std::numeric_limits<double>::infinity();
    for (int i = 0; i < rules_.samples; i++) {
      const double share = kNearest + (kFarthest - kNearest) * i / std::max(rules_.samples - 1, 1);
      const double depth = far * share, radius = kHalf * kBlock / v_.K[0] * depth;
      double point[3], score = -rules_.locality * std::fabs(std::log(depth / known));
      point_at(ray, depth, point);
      for (int other = 0; other < count_; other++) {
        if (other != index_) score += support(other, point, radius, rgb);
      }
      if (score > most) {
        most = score;
        best = depth;
      }
    }
    const bool on = most < -kHalf * rules_.refuted || !v_.near_moving[pixel(block.row, block.column)];
    return {on ? kBeforeIt * far : best, on};
  }

  // Writes what is born of a block as number `at`; how many those are.
  int64_t bear(const Block &block, int64_t at) const {
    const int64_t first = pixel(block.row, block.column), below = first + v_.width, last = below + 1;
    const double far = v_.far[first];
    float *rgb = v_.colours + 3 * at;
    double ray[3], *point = v_.means + 3 * at;
    for (int k = 0; k < 3; k++) {
      const float above = v_.rgb[3 * first + k] + v_.rgb[3 * first + 3 + k];
      rgb[k] = (above + v_.rgb[3 * below + k] + v_.rgb[3 * last + k]) * 0.25f;
      ray[k] = (v_.rays[3 * first + k] + v_.rays[3 * last + k]) / 2;
    }
    const Depth depth = v_.measured != nullptr ? measured(first, far) : agreed(block, ray, far, rgb);
    const bool lasting = depth.on_background && v_.alpha[first] < rules_.solid;
    point_at(ray, depth.value, point);
    if (depth.on_background && !lasting && contradicted(point)) return 0;
    v_.radii[at] = rules_.spread * kBlock * depth.value / v_.K[0];
    v_.on_background[at] = depth.on_background;
    v_.lasting[at] = lasting;
    return 1;
  }

  const BirthRules &rules_;
  const BirthView *views_;
  const int count_, index_;
  const BirthView &v_;
  std::vector<Pinhole> cameras_;
  std::vector<Block> blocks_;
  std::vector<double> pooled_;  // [kCells, kCells]; empty where nothing is shown that moves
};

}  // namespace model
