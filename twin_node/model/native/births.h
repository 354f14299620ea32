// New Gaussians where a rendering does not explain an image: `find_births_plainly` in one go.
#pragma once

#include <vector>

#include "birth_depths.h"

namespace model {

// One view's births; `others` are the views that have a say in their depth.
class ViewBirths {
 public:
  ViewBirths(const BirthRequest &request, int index)
      : request_(request), rules_(*request.rules), views_(request.views), count_(request.count), index_(index),
        v_(request.views[index]) {
    for (int i = 0; i < count_; i++) {
      cameras_.emplace_back(views_[i].viewmat, views_[i].K, views_[i].width, views_[i].height);
    }
  }

  void run() {
    find_blocks();
    for (Block &block : blocks_) describe(block);
    const std::vector<Lying> lying = v_.measured != nullptr ? measured() : depths();
    int64_t born = 0;
    for (size_t i = 0; i < blocks_.size(); i++) born += bear(blocks_[i], lying[i], born);
    *v_.born = born;
  }

 private:
  // From a block's first pixel to the one in its middle, or before that.
  int middle() const { return (rules_.side - 1) / 2; }

  int64_t pixel(int row, int column) const { return static_cast<int64_t>(row) * v_.width + column; }

  float error(int64_t at) const {
    const bool replaced = !v_.stale[at] || v_.alpha[at] < rules_.solid;
    if (!v_.active[at] || !(v_.surprise[at] > kHalf * rules_.threshold) || !replaced) return 0.f;
    float most = 0.f;
    for (int k = 0; k < 3; k++) most = std::max(most, std::fabs(v_.rgb[3 * at + k] - v_.shown[4 * at + k]));
    return most;
  }

  // The mean of `value` over the pixels of a block.
  template <typename Value>
  float mean_of_block(int row, int column, const Value &value) const {
    float sum = 0.f;
    for (int i = 0; i < rules_.side; i++) {
      const int64_t first = pixel(row + i, column);
      for (int k = 0; k < rules_.side; k++) sum += value(first + k);
    }
    return sum / static_cast<float>(rules_.side * rules_.side);
  }

  // The worst blocks, at most as many as may be born.
  void find_blocks() {
    const int side = rules_.side;
    for (int row = 0; row + side <= v_.height; row += side) {
      for (int column = 0; column + side <= v_.width; column += side) {
        const float mean = mean_of_block(row, column, [this](int64_t at) { return error(at); });
        if (mean > rules_.threshold) blocks_.push_back({mean, row + middle(), column + middle(), {}, {}});
      }
    }
    std::stable_sort(blocks_.begin(), blocks_.end(), [](const Block &a, const Block &b) { return a.error > b.error; });
    if (static_cast<int64_t>(blocks_.size()) > rules_.quota) blocks_.resize(rules_.quota);
  }

  // A block's mean colour and the ray through its middle.
  void describe(Block &block) const {
    const int row = block.row - middle(), column = block.column - middle(), even = 1 - rules_.side % 2;
    const int64_t before = pixel(block.row, block.column), after = pixel(block.row + even, block.column + even);
    for (int k = 0; k < 3; k++) {
      block.rgb[k] = mean_of_block(row, column, [this, k](int64_t at) { return v_.rgb[3 * at + k]; });
      block.ray[k] = (v_.rays[3 * before + k] + v_.rays[3 * after + k]) / 2;
    }
  }

  std::vector<Lying> depths() const { return BirthDepths(request_, index_, cameras_, blocks_).run(); }

  std::vector<Lying> measured() const {
    std::vector<Lying> lying;
    for (const Block &block : blocks_) {
      const int64_t at = pixel(block.row, block.column);
      const double far = v_.far[at], depth = v_.measured[at] > 0 ? v_.measured[at] : far;
      lying.push_back({depth, depth > (1 - rules_.same_depth) * far});
    }
    return lying;
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

  // Writes what is born of a block as number `at`; how many those are.
  int64_t bear(const Block &block, const Lying &lying, int64_t at) const {
    double *point = v_.means + 3 * at;
    const bool lasting = lying.on_background && v_.alpha[pixel(block.row, block.column)] < rules_.solid;
    point_at(v_, block.ray, lying.depth, point);
    if (lying.on_background && !lasting && contradicted(point)) return 0;
    std::copy(block.rgb, block.rgb + 3, v_.colours + 3 * at);
    v_.radii[at] = rules_.spread * rules_.side * lying.depth / v_.K[0];
    v_.on_background[at] = lying.on_background;
    v_.lasting[at] = lasting;
    return 1;
  }

  const BirthRequest &request_;
  const BirthRules &rules_;
  const BirthView *views_;
  const int count_, index_;
  const BirthView &v_;
  std::vector<Pinhole> cameras_;
  std::vector<Block> blocks_;
};

}  // namespace model
