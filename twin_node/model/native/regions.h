// Regions of binary images: joined pixels, closed gaps, filled holes.
#pragma once

#include <cstdint>
#include <vector>

namespace model {

using Mask = std::vector<uint8_t>;

// The places of a kernel relative to its middle.
struct Shift {
  int row, column;
};
inline std::vector<Shift> shifts_of(const uint8_t *kernel, int radius) {
  std::vector<Shift> shifts;
  for (int row = -radius; row <= radius; row++) {
    for (int column = -radius; column <= radius; column++) {
      if (kernel[(row + radius) * (2 * radius + 1) + column + radius]) shifts.push_back({row, column});
    }
  }
  return shifts;
}

// A binary image with a margin of zeros, so that shifts of up to `margin` need no look at the edges.
struct Padded {
  int width, height, margin, stride;
  Mask pixels;
  Padded(int width, int height, int margin)
      : width(width),
        height(height),
        margin(margin),
        stride(width + 2 * margin),
        pixels(static_cast<size_t>(stride) * (height + 2 * margin), 0) {}
  uint8_t *row(int row) { return pixels.data() + static_cast<int64_t>(row + margin) * stride + margin; }
  const uint8_t *row(int row) const { return pixels.data() + static_cast<int64_t>(row + margin) * stride + margin; }
};

// `mask` [H, W] dilated by symmetric `shifts` of up to `radius`; the result reaches `margin` beyond the image.
inline Padded dilated(const uint8_t *mask, int width, int height, const std::vector<Shift> &shifts, int radius,
                      int margin) {
  Padded out(width, height, margin + radius);
  for (int row = 0; row < height; row++) {
    for (int column = 0; column < width; column++) {
      if (!mask[row * width + column]) continue;
      for (const Shift &shift : shifts) out.row(row + shift.row)[column + shift.column] = 1;
    }
  }
  return out;
}

// `mask` [H, W] with gaps closed that are narrower than the kernel; it may be wider than the image.
inline Mask closed(const uint8_t *mask, int width, int height, const std::vector<Shift> &shifts, int radius) {
  const Padded wide = dilated(mask, width, height, shifts, radius, 0);
  Mask out(static_cast<size_t>(width) * height);
  for (int row = 0; row < height; row++) {
    for (int column = 0; column < width; column++) {
      uint8_t all = 1;
      for (size_t i = 0; i < shifts.size() && all; i++) all = wide.row(row + shifts[i].row)[column + shifts[i].column];
      out[row * width + column] = all;
    }
  }
  return out;
}

// Pixels of `mask` [H, W] whose neighbours (`shifts`) inside the image are all in it as well.
inline Mask eroded(const Mask &mask, int width, int height, const std::vector<Shift> &shifts) {
  Mask out(mask.size());
  for (int row = 0; row < height; row++) {
    for (int column = 0; column < width; column++) {
      uint8_t all = 1;
      for (size_t i = 0; i < shifts.size() && all; i++) {
        const int y = row + shifts[i].row, x = column + shifts[i].column;
        if (y >= 0 && y < height && x >= 0 && x < width) all = mask[y * width + x];
      }
      out[row * width + column] = all;
    }
  }
  return out;
}

// Calls visit(pixel) for `start` and all that is joined to it through pixels that accept(pixel) takes, each once; accept
// must refuse what has been visited.
template <bool diagonal, class Accept, class Visit>
inline void flood(int start, int width, int height, std::vector<int> &stack, const Accept &accept,
                  const Visit &visit) {
  stack.assign(1, start);
  visit(start);
  while (!stack.empty()) {
    const int at = stack.back(), row = at / width, column = at % width;
    stack.pop_back();
    for (int y = row - 1; y <= row + 1; y++) {
      for (int x = column - 1; x <= column + 1; x++) {
        if (y < 0 || y >= height || x < 0 || x >= width) continue;
        if (!diagonal && y != row && x != column) continue;
        const int next = y * width + x;
        if (!accept(next)) continue;
        visit(next);
        stack.push_back(next);
      }
    }
  }
}

// `mask` [H, W] with its holes filled: pixels that are not joined, edge to edge, to the image's border from outside.
inline Mask filled(const Mask &mask, int width, int height) {
  Mask out(mask.size(), 1);
  std::vector<int> stack;
  const auto open = [&](int at) { return out[at] && !mask[at]; };
  const auto empty = [&](int at) { out[at] = 0; };
  const auto from = [&](int at) {
    if (open(at)) flood<false>(at, width, height, stack, open, empty);
  };
  for (int column = 0; column < width; column++) {
    from(column);
    from((height - 1) * width + column);
  }
  for (int row = 0; row < height; row++) {
    from(row * width);
    from(row * width + width - 1);
  }
  return out;
}

// Regions of pixels over `weak`, joined by edges or corners, that reach `strong` somewhere and have `least` pixels.
inline Mask strong_regions(const std::vector<float> &evidence, int width, int height, double weak, double strong,
                           double least) {
  Mask out(evidence.size(), 0), visited(evidence.size(), 0);
  std::vector<int> stack, region;
  for (int start = 0; start < width * height; start++) {
    if (visited[start] || !(evidence[start] > weak)) continue;
    bool reached = false;
    region.clear();
    flood<true>(
        start, width, height, stack, [&](int at) { return !visited[at] && evidence[at] > weak; },
        [&](int at) {
          visited[at] = 1;
          region.push_back(at);
          reached = reached || evidence[at] > strong;
        });
    if (!reached || static_cast<double>(region.size()) < least) continue;
    for (const int at : region) out[at] = 1;
  }
  return out;
}

}  // namespace model
