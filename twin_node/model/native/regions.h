// Regions of binary images: joined pixels, closed gaps, filled holes.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

namespace model {

using Mask = std::vector<uint8_t>;

// A row of a kernel, relative to its middle: the columns -reach ... reach.
struct Stretch {
  int row, reach;
};
using Kernel = std::vector<Stretch>;

// A kernel [2 radius + 1, 2 radius + 1] whose rows are stretches about its middle, as those of discs are.
inline Kernel kernel_of(const uint8_t *places, int radius) {
  Kernel kernel;
  for (int row = -radius; row <= radius; row++) {
    const uint8_t *middle = places + (row + radius) * (2 * radius + 1) + radius;
    int reach = radius;
    while (reach >= 0 && !middle[reach]) reach--;
    if (reach >= 0) kernel.push_back({row, reach});
  }
  return kernel;
}

// A binary image, a bit per pixel, with a margin of zeros on all sides: shifting it needs no look at its edges.
class Bits {
 public:
  static constexpr int kWord = 64, kMargin = 64;  // pixels

  Bits(int width, int height)
      : width_(width),
        height_(height),
        words_((width + 2 * kMargin + kWord - 1) / kWord),
        bits_(static_cast<size_t>(words_) * (height + 2 * kMargin), 0) {}

  // Of a mask [H, W] of zeros and ones.
  Bits(const uint8_t *mask, int width, int height) : Bits(width, height) {
    for (int y = 0; y < height; y++) {
      const uint8_t *from = mask + static_cast<int64_t>(y) * width;
      uint64_t *to = row(y) + kMargin / kWord;
      int x = 0;
      for (; x + 8 <= width; x += 8) to[x / kWord] |= bits_of(from + x) << x % kWord;
      for (; x < width; x++) to[x / kWord] |= uint64_t{from[x]} << x % kWord;
    }
  }

  Mask unpacked() const {
    Mask out(static_cast<size_t>(width_) * height_);
    for (int y = 0; y < height_; y++) {
      const uint64_t *from = row(y) + kMargin / kWord;
      uint8_t *to = out.data() + static_cast<int64_t>(y) * width_;
      int x = 0;
      for (; x + 8 <= width_; x += 8) put_bytes(from[x / kWord] >> x % kWord & 0xff, to + x);
      for (; x < width_; x++) to[x] = from[x / kWord] >> x % kWord & 1;
    }
    return out;
  }

  // With the pixels that `kernel`, whose radius is less than half the margin, covers about those that are set. Rows are
  // widened once for all of the kernel's rows: a disc takes some steps per row of it, not one per place.
  Bits dilated(const Kernel &kernel) const {
    Bits out(width_, height_), wide(*this);
    int widest = 0;
    for (const Stretch &stretch : kernel) widest = std::max(widest, stretch.reach);
    for (int reach = 0; reach <= widest; reach++) {
      for (int y = -kMargin / 2; y < height_ + kMargin / 2 && reach > 0; y++) {
        wide.add(y, row(y), reach);
        wide.add(y, row(y), -reach);
      }
      for (const Stretch &stretch : kernel) {
        if (stretch.reach != reach) continue;
        for (int y = -kMargin / 2; y < height_ + kMargin / 2; y++) out.add(y + stretch.row, wide.row(y), 0);
      }
    }
    return out;
  }

  // All pixels, those of the margin too, the other way round.
  Bits inverted() const {
    Bits out(*this);
    for (uint64_t &word : out.bits_) word = ~word;
    return out;
  }

 private:
  // Eight bytes of zeros and ones as eight bits, the first the lowest: byte i, at bit 8 i, is moved to bit 56 + i, and
  // no two products meet.
  static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__);
  static uint64_t bits_of(const uint8_t *bytes) {
    uint64_t eight;
    std::memcpy(&eight, bytes, 8);
    return eight * 0x0102040810204080u >> 56;
  }

  // The way back: each byte keeps its own bit of a copy of all eight, and becomes one if that is set.
  static void put_bytes(uint64_t bits, uint8_t *bytes) {
    const uint64_t own = bits * 0x0101010101010101u & 0x8040201008040201u;
    const uint64_t eight = (own + 0x7f7f7f7f7f7f7f7fu) >> 7 & 0x0101010101010101u;
    std::memcpy(bytes, &eight, 8);
  }

  uint64_t *row(int y) { return bits_.data() + static_cast<int64_t>(y + kMargin) * words_; }
  const uint64_t *row(int y) const { return bits_.data() + static_cast<int64_t>(y + kMargin) * words_; }

  // Sets in row `y` what is set in `from`, `by` columns on.
  void add(int y, const uint64_t *from, int by) {
    uint64_t *to = row(y);
    if (by == 0) {
      for (int i = 0; i < words_; i++) to[i] |= from[i];
    } else if (by > 0) {
      for (int i = 0; i < words_; i++) to[i] |= from[i] << by | (i > 0 ? from[i - 1] >> (kWord - by) : 0);
    } else {
      for (int i = 0; i < words_; i++) {
        to[i] |= from[i] >> -by | (i + 1 < words_ ? from[i + 1] << (kWord + by) : 0);
      }
    }
  }

  int width_, height_, words_;
  std::vector<uint64_t> bits_;
};

// `mask` [H, W] dilated by `kernel`.
inline Mask dilated(const uint8_t *mask, int width, int height, const Kernel &kernel) {
  return Bits(mask, width, height).dilated(kernel).unpacked();
}

// `mask` [H, W] with gaps closed that are narrower than the kernel, which is symmetric.
inline Mask closed(const Mask &mask, int width, int height, const Kernel &kernel) {
  return Bits(mask.data(), width, height).dilated(kernel).inverted().dilated(kernel).inverted().unpacked();
}

// Pixels of `mask` [H, W] whose neighbours (of a symmetric `kernel`) inside the image are all in it as well.
inline Mask eroded(Mask mask, int width, int height, const Kernel &kernel) {
  for (uint8_t &pixel : mask) pixel ^= 1;
  mask = dilated(mask.data(), width, height, kernel);
  for (uint8_t &pixel : mask) pixel ^= 1;
  return mask;
}

// A stretch of pixels of one row that `Runs` hold.
struct Run {
  int row, begin, end, parent;
};

// The pixels of an image that are in(pixel), as stretches of rows that know which region they belong to.
class Runs {
 public:
  // `reach`: 0 joins pixels at their edges, 1 at their corners as well.
  template <class In>
  Runs(int width, int height, int reach, const In &in) {
    size_t above = 0;
    for (int row = 0; row < height; row++) {
      const size_t first = runs.size();
      for (int x = 0; x < width; x++) {
        if (!in(row * width + x)) continue;
        const int begin = x;
        while (x < width && in(row * width + x)) x++;
        runs.push_back({row, begin, x, static_cast<int>(runs.size())});
      }
      size_t other = above;
      for (size_t i = first; i < runs.size(); i++) {
        while (other < first && runs[other].end + reach <= runs[i].begin) other++;
        for (size_t j = other; j < first && runs[j].begin < runs[i].end + reach; j++) {
          join(static_cast<int>(i), static_cast<int>(j));
        }
      }
      above = first;
    }
    for (size_t i = 0; i < runs.size(); i++) runs[i].parent = root(static_cast<int>(i));
  }

  std::vector<Run> runs;  // `parent` is the first of the region

 private:
  int root(int i) const {
    while (runs[i].parent != i) i = runs[i].parent;
    return i;
  }
  void join(int a, int b) {
    a = root(a);
    b = root(b);
    runs[std::max(a, b)].parent = std::min(a, b);
  }
};

// `mask` [H, W] with its holes filled: pixels that are not joined, edge to edge, to the image's border from outside.
inline Mask filled(const Mask &mask, int width, int height) {
  const Runs empty(width, height, 0, [&](int at) { return !mask[at]; });
  Mask open(empty.runs.size(), 0), out(mask.size(), 1);
  for (const Run &run : empty.runs) {
    if (run.row == 0 || run.row == height - 1 || run.begin == 0 || run.end == width) open[run.parent] = 1;
  }
  for (const Run &run : empty.runs) {
    if (open[run.parent]) std::memset(&out[run.row * width + run.begin], 0, run.end - run.begin);
  }
  return out;
}

// Regions of pixels over `weak`, joined by edges or corners, that reach `strong` somewhere and have `least` pixels.
inline Mask strong_regions(const std::vector<float> &evidence, int width, int height, float weak, float strong,
                           double least) {
  const Runs found(width, height, 1, [&](int at) { return evidence[at] > weak; });
  Mask reached(found.runs.size(), 0), out(evidence.size(), 0);
  std::vector<int> sizes(found.runs.size(), 0);
  for (const Run &run : found.runs) {
    const float *pixels = evidence.data() + run.row * width;
    sizes[run.parent] += run.end - run.begin;
    for (int x = run.begin; x < run.end; x++) reached[run.parent] |= pixels[x] > strong;
  }
  for (const Run &run : found.runs) {
    if (!reached[run.parent] || sizes[run.parent] < least) continue;
    std::memset(&out[run.row * width + run.begin], 1, run.end - run.begin);
  }
  return out;
}

}  // namespace model
