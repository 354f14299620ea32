// What the views of a rig say about every voxel.
#pragma once

#include "interface.h"

namespace forecast {

constexpr int kBlock = 4;  // voxels along a side of a block
constexpr int kVoxels = kBlock * kBlock * kBlock;

// Two views must show the same to be believed where no surface is measured.
constexpr int kWitnesses = 2;

inline Verdict verdict_of(const CarveRequest &r, int64_t place) {
  int moving = 0, robot = 0, seen = 0;
  bool surface = false, beside = false;
  for (int v = 0; v < r.views; v++) {
    const Sight &sight = r.sights[v];
    const int32_t pixel = sight.pixels[place];
    const float depth = sight.depths[place];
    if (depth < sight.free_until[pixel]) return kFree;
    const uint8_t flags = sight.flags[pixel];
    moving += (flags & kMoving) != 0;
    robot += (flags & kRobot) != 0;
    seen += (flags & kSeen) != 0;
    beside |= (flags & kBeside) != 0;
    surface |= sight.begin && sight.begin[pixel] <= depth && depth < sight.end[pixel];
  }
  if (moving >= kWitnesses || surface) return beside ? kMayMove : kLikelyMoves;
  return robot >= kWitnesses && robot == seen ? kFree : kUnknown;
}

inline void carve(const CarveRequest &r) {
  const int64_t by = (r.ny + kBlock - 1) / kBlock, bz = (r.nz + kBlock - 1) / kBlock;
#pragma omp parallel for schedule(static) num_threads(r.threads)
  for (int64_t i = 0; i < r.blocks; i++) {
    const int64_t block = r.chosen[i];
    const int64_t x0 = block / (by * bz) * kBlock, y0 = block / bz % by * kBlock, z0 = block % bz * kBlock;
    for (int offset = 0; offset < kVoxels; offset++) {
      const int64_t x = x0 + offset / (kBlock * kBlock), y = y0 + offset / kBlock % kBlock, z = z0 + offset % kBlock;
      if (x >= r.nx || y >= r.ny || z >= r.nz) continue;
      r.verdicts[(x * r.ny + y) * r.nz + z] = verdict_of(r, block * kVoxels + offset);
    }
  }
}

}  // namespace forecast
