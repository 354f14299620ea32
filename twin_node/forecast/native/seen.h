// What one image shows to move: its brightness, and the blobs that it comes in.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <vector>

#include "interface.h"

namespace forecast {

// The pixels of a mask and the eight about each.
inline void mark_near(const SeeRequest &r) {
  const int32_t width = r.width, height = r.height;
  std::vector<uint8_t> across(static_cast<size_t>(width) * height + 2);
  for (int32_t y = 0; y < height; y++) {
    const uint8_t *row = r.moving + static_cast<int64_t>(y) * width;
    uint8_t *to = across.data() + static_cast<int64_t>(y) * width;
    std::copy_n(row, width, to);
    for (int32_t x = 1; x < width; x++) to[x] |= row[x - 1];
    for (int32_t x = 1; x < width; x++) to[x - 1] |= row[x];
  }
  for (int32_t y = 0; y < height; y++) {
    const uint8_t *own = across.data() + static_cast<int64_t>(y) * width;
    const uint8_t *above = y > 0 ? own - width : own, *below = y + 1 < height ? own + width : own;
    uint8_t *to = r.near + static_cast<int64_t>(y) * width;
    for (int32_t x = 0; x < width; x++) to[x] = (above[x] | own[x] | below[x]) != 0;
  }
}

// Of what moves; weights of ITU-R BT.601 as OpenCV rounds them.
inline void paint(const SeeRequest &r) {
  constexpr int32_t kRed = 9798, kGreen = 19235, kBlue = 3735, kBits = 15;
  const int64_t pixels = static_cast<int64_t>(r.width) * r.height;
  for (int64_t i = 0; i < pixels; i++) {
    const uint8_t *rgb = r.rgb + 3 * i;
    const int32_t sum = rgb[0] * kRed + rgb[1] * kGreen + rgb[2] * kBlue + (1 << (kBits - 1));
    r.grey[i] = static_cast<uint8_t>(r.near[i] ? sum >> kBits : r.painted);
  }
}

// Pixels side by side in a row, to one before the last.
struct PixelRun {
  int32_t row, begin, end;
};

// Blobs are pixels that touch at sides or corners, numbered from 1 in the order of their first ones.
class Blobs {
 public:
  explicit Blobs(const SeeRequest &request) : r_(request) {
    find();
    parents_.resize(runs_.size());
    std::iota(parents_.begin(), parents_.end(), 0);
    for (size_t own = 0, above = 0; own < runs_.size(); own++) {
      const PixelRun &one = runs_[own];
      while (runs_[above].row < one.row - 1) above++;
      while (runs_[above].row == one.row - 1 && runs_[above].end < one.begin) above++;
      for (size_t i = above; runs_[i].row == one.row - 1 && runs_[i].begin <= one.end; i++) {
        const size_t a = root(own), b = root(i);
        parents_[std::max(a, b)] = std::min(a, b);
      }
    }
  }

  void write() {
    struct Sums {
      int64_t pixels = 0, x = 0, y = 0;
      int32_t left = INT32_MAX, right = 0, top = INT32_MAX, bottom = 0;
    };
    std::vector<Sums> sums;
    std::vector<int32_t> labels(runs_.size());
    int64_t *window = r_.found + 1;
    window[0] = r_.width, window[2] = r_.height, window[1] = window[3] = 0;
    std::fill_n(r_.labels, static_cast<int64_t>(r_.width) * r_.height, 0);
    for (size_t i = 0; i < runs_.size(); i++) {  // a root is the first run of its blob
      const size_t first = root(i);
      if (first == i) sums.emplace_back();
      const int32_t label = labels[i] = first == i ? static_cast<int32_t>(sums.size()) : labels[first];
      const PixelRun &one = runs_[i];
      Sums &own = sums[label - 1];
      const int64_t length = one.end - one.begin;
      own.pixels += length, own.y += length * one.row, own.x += length * (one.begin + one.end - 1) / 2;
      own.left = std::min(own.left, one.begin), own.right = std::max(own.right, one.end);
      own.top = std::min(own.top, one.row), own.bottom = one.row + 1;
      std::fill_n(r_.labels + static_cast<int64_t>(one.row) * r_.width + one.begin, length, label);
      window[0] = std::min<int64_t>(window[0], one.begin), window[1] = std::max<int64_t>(window[1], one.end);
      window[2] = std::min<int64_t>(window[2], one.row), window[3] = one.row + 1;
    }
    if (sums.empty()) std::fill_n(window, 4, 0);
    int64_t count = 0;
    for (size_t i = 0; i < sums.size(); i++) {
      const Sums &own = sums[i];
      const double side = std::max(own.right - own.left, own.bottom - own.top), pixels = static_cast<double>(own.pixels);
      if (own.pixels < r_.smallest || !(pixels > r_.compact * (side * side))) continue;
      double *to = r_.blobs + 4 * count++;
      to[0] = static_cast<double>(i + 1), to[1] = pixels;
      to[2] = static_cast<double>(own.x - window[0] * own.pixels) / pixels + static_cast<double>(window[0]);
      to[3] = static_cast<double>(own.y - window[2] * own.pixels) / pixels + static_cast<double>(window[2]);
    }
    r_.found[0] = count;
  }

 private:
  void find() {
    for (int32_t y = 0; y < r_.height; y++) {
      const uint8_t *row = r_.near + static_cast<int64_t>(y) * r_.width;
      const auto next = [&](int32_t x, int value) {
        const void *found = std::memchr(row + x, value, r_.width - x);
        return found ? static_cast<int32_t>(static_cast<const uint8_t *>(found) - row) : r_.width;
      };
      for (int32_t begin = 0; (begin = next(begin, 1)) < r_.width;) {
        const int32_t end = next(begin, 0);
        runs_.push_back({y, begin, end});
        begin = end;
      }
    }
  }

  size_t root(size_t i) {
    while (parents_[i] != i) i = parents_[i] = parents_[parents_[i]];
    return i;
  }

  const SeeRequest &r_;
  std::vector<PixelRun> runs_;
  std::vector<size_t> parents_;
};

inline void see(const SeeRequest &r) {
  mark_near(r);
  paint(r);
  Blobs(r).write();
}

}  // namespace forecast
