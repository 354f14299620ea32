// New Gaussians where a rendering does not explain an image: `find_births_reference` in one go.
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
    const std::vector<Lying> lying = v_.measured != nullptr ? measured() : depths();
    int64_t born = 0;
    for (size_t i = 0; i < blocks_.size(); i++) born += bear(blocks_[i], lying[i], born);
    *v_.born = born;
  }

 private:
  int64_t pixel(int row, int column) const { return static_cast<int64_t>(row) * v_.width + column; }

  float error(int64_t at) const {
    const bool replaced = !v_.stale[at] || v_.alpha[at] < rules_.solid;
    if (!v_.active[at] || !(v_.surprise[at] > kHalf * rules_.threshold) || !replaced) return 0.f;
    float most = 0.f;
    for (int k = 0; k < 3; k++) most = std::max(most, std::fabs(v_.rgb[3 * at + k] - v_.shown[4 * at + k]));
    return most;
  }

  // The sum of `value` over the pixels of a square that begins at `first`.
  template <typename Value>
  float sum(int64_t first, int side, const Value &value) const {
    float total = 0.f;
    for (int i = 0; i < side; i++) {
      for (int k = 0; k < side; k++) total += value(first + static_cast<int64_t>(i) * v_.width + k);
    }
    return total;
  }

  // The worst blocks, at most as many as may be born: large ones where all of them is wrong and looks alike.
  void find_blocks() {
    const int rows = v_.height / kBlock, columns = v_.width / kBlock, most = rules_.side / kBlock;
    errors_.resize(static_cast<size_t>(rows) * columns);
    for (int i = 0; i < rows; i++) {
      for (int k = 0; k < columns; k++) {
        errors_[i * columns + k] =
            sum(pixel(i * kBlock, k * kBlock), kBlock, [this](int64_t at) { return error(at); });
      }
    }
    if (most > 1) {
      for (int i = 0; i + most <= rows; i += most) {
        for (int k = 0; k + most <= columns; k += most) unite(i, k, most, columns);
      }
    }
    for (int i = 0; i < rows; i++) {
      for (int k = 0; k < columns; k++) {
        if (is_wrong(errors_[i * columns + k])) add(errors_[i * columns + k], i * kBlock, k * kBlock, kBlock);
      }
    }
    std::stable_sort(blocks_.begin(), blocks_.end(), [](const Block &a, const Block &b) { return a.error > b.error; });
    if (static_cast<int64_t>(blocks_.size()) > rules_.quota) blocks_.resize(rules_.quota);
  }

  // Of one of the smallest blocks.
  bool is_wrong(float error) const { return error > rules_.threshold * kBlock * kBlock; }

  // Makes one block of `most` squared small ones, the first of them in row `i` and column `k` of these, where it can.
  void unite(int i, int k, int most, int columns) {
    float low[3], high[3], total = 0.f;
    for (int row = i; row < i + most; row++) {
      for (int column = k; column < k + most; column++) {
        const float error = errors_[row * columns + column];
        if (!is_wrong(error)) return;
        total += error;
        for (int c = 0; c < 3; c++) {
          const float mean = colour(pixel(row * kBlock, column * kBlock), kBlock, c);
          const bool is_first = row == i && column == k;
          low[c] = is_first ? mean : std::min(low[c], mean);
          high[c] = is_first ? mean : std::max(high[c], mean);
        }
      }
    }
    for (int c = 0; c < 3; c++) {
      if (!(high[c] - low[c] <= rules_.alike)) return;
    }
    for (int row = i; row < i + most; row++) std::fill_n(errors_.begin() + row * columns + k, most, 0.f);
    add(total, i * kBlock, k * kBlock, most * kBlock);
  }

  float colour(int64_t first, int side, int channel) const {
    const float total = sum(first, side, [this, channel](int64_t at) { return v_.rgb[3 * at + channel]; });
    return total / static_cast<float>(side * side);
  }

  // Adds a block with its mean colour and the ray through its middle; `row` and `column` are those of its first pixel.
  void add(float error, int row, int column, int side) {
    const int middle = side / 2 - 1;
    const int64_t before = pixel(row + middle, column + middle), after = before + v_.width + 1;
    Block block{error, row + middle, column + middle, side, {}, {}};
    for (int k = 0; k < 3; k++) {
      block.rgb[k] = colour(pixel(row, column), side, k);
      block.ray[k] = (v_.rays[3 * before + k] + v_.rays[3 * after + k]) / 2;
    }
    blocks_.push_back(block);
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
    v_.radii[at] = rules_.spread * block.side * lying.depth / v_.K[0];
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
  std::vector<float> errors_;  // of the smallest blocks, 0 where a larger one has taken it
};

}  // namespace model
