// What the views of a rig say about every voxel.
#pragma once

#include <algorithm>
#include <cstring>
#include <vector>

#include "../../native/crew.h"
#include "interface.h"
#include "overview.h"

namespace forecast {

constexpr int kBlock = 4;  // voxels along a side of a block
constexpr int kVoxels = kBlock * kBlock * kBlock;

// Two views must show the same to be believed where no surface is measured.
constexpr int kWitnesses = 2;

// What the views say of the voxels of one block, which lie side by side in the tables: vectors of `kVoxels`.
class BlockVerdicts {
 public:
  BlockVerdicts(
      const CarveRequest &request, const std::vector<Overview> &overviews,
      const std::vector<std::vector<int32_t>> &flags)
      : r_(request), overviews_(overviews), flags_(flags), dividing_(request.views, 0) {}

  // Verdicts on a block; null where all of it is free.
  const uint8_t *of(int64_t block) {
    if (freed_as_a_whole(block)) return nullptr;
    const bool explicable = divided(block);
    if (freed_voxel_by_voxel(block * kVoxels)) return nullptr;
    if (!explicable) {
      for (int i = 0; i < kVoxels; i++) verdicts_[i] = open_[i] ? kUnknown : kFree;
      return verdicts_;
    }
    for (int i = 0; i < kVoxels; i++) moving_[i] = robot_[i] = seen_[i] = surface_[i] = beside_[i] = 0;
    for (int v = 0; v < r_.views; v++) look(r_.sights[v], flags_[v].data(), block * kVoxels);
    for (int i = 0; i < kVoxels; i++) {
      const int32_t explained = (moving_[i] >= kWitnesses) | surface_[i];
      const int32_t itself = (robot_[i] >= kWitnesses) & (robot_[i] == seen_[i]);
      const int32_t moves = beside_[i] ? kMayMove : kLikelyMoves, still = itself ? kFree : kUnknown;
      verdicts_[i] = open_[i] ? (explained ? moves : still) : kFree;
    }
    return verdicts_;
  }

 private:
  // Whether some view frees all of a block. Neighbours are often freed by the same one.
  bool freed_as_a_whole(int64_t block) {
    for (int turn = 0; turn < r_.views; turn++, likeliest_ = (likeliest_ + 1) % r_.views) {
      const Sight &sight = r_.sights[likeliest_];
      const Overview &overview = overviews_[likeliest_];
      const auto window = [&] { return overview.window(sight.windows + 4 * block); };
      if (sight.whole[block] && sight.far[block] < overview.least(window())) return true;
    }
    return false;
  }

  // Finds the views that may free parts of a block, and says whether any may explain what is left.
  bool divided(int64_t block) {
    int moving = 0, robot = 0, surface = 0;
    dividing_count_ = 0;
    for (int v = 0; v < r_.views; v++) {
      const Sight &sight = r_.sights[v];
      const Overview &overview = overviews_[v];
      const int32_t *ends = sight.windows + 4 * block;
      Extremes all = overview.outside();
      if (ends[0] <= ends[1]) all = joined(all, overview.over(overview.window(ends)));
      if (sight.near[block] < all.most) dividing_[dividing_count_++] = v;
      moving += (all.flags & kMoving) != 0;
      robot += (all.flags & kRobot) != 0;
      surface |= all.flags & kSurface;
    }
    return moving >= kWitnesses || robot >= kWitnesses || surface;
  }

  bool freed_voxel_by_voxel(int64_t first) {
    for (int i = 0; i < kVoxels; i++) open_[i] = 1;
    for (int k = 0; k < dividing_count_; k++) {
      const int v = dividing_[k];
      const int32_t *pixels = r_.sights[v].pixels + first;
      const float *depths = r_.sights[v].depths + first, *free_until = r_.sights[v].free_until;
      int32_t left = 0;
      for (int i = 0; i < kVoxels; i++) {
        open_[i] &= !(depths[i] < free_until[pixels[i]]);
        left |= open_[i];
      }
      if (!left) return true;
    }
    return false;
  }

  void look(const Sight &sight, const int32_t *flags, int64_t first) {
    const int32_t *pixels = sight.pixels + first;
    for (int i = 0; i < kVoxels; i++) {
      const int32_t shown = flags[pixels[i]];
      moving_[i] += (shown & kMoving) != 0;
      robot_[i] += (shown & kRobot) != 0;
      seen_[i] += (shown & kSeen) != 0;
      beside_[i] |= shown & kBeside;
    }
    if (!sight.begin) return;
    const float *depths = sight.depths + first;
    for (int i = 0; i < kVoxels; i++) {
      surface_[i] |= (sight.begin[pixels[i]] <= depths[i]) & (depths[i] < sight.end[pixels[i]]);
    }
  }

  const CarveRequest &r_;
  const std::vector<Overview> &overviews_;
  const std::vector<std::vector<int32_t>> &flags_;
  std::vector<int> dividing_;  // views that may free parts of the block, the first so many of it
  int dividing_count_ = 0;
  int32_t open_[kVoxels], moving_[kVoxels], robot_[kVoxels], seen_[kVoxels], surface_[kVoxels], beside_[kVoxels];
  uint8_t verdicts_[kVoxels];
  int likeliest_ = 0;
};

inline void carve(const CarveRequest &r) {
  const int64_t bx = (r.nx + kBlock - 1) / kBlock, by = (r.ny + kBlock - 1) / kBlock, bz = (r.nz + kBlock - 1) / kBlock;
  std::vector<std::vector<int32_t>> flags;  // words are gathered many at a time, bytes are not
  std::vector<Overview> overviews;
  for (int v = 0; v < r.views; v++) {
    flags.emplace_back(r.sights[v].flags, r.sights[v].flags + r.sights[v].size);
    overviews.emplace_back(r.sights[v]);
  }
  std::vector<BlockVerdicts> slabs(bx, BlockVerdicts(r, overviews, flags));
  crew::parallel_for(r.threads, bx, [&](int64_t slab) {
    for (int64_t block = slab * by * bz; block < (slab + 1) * by * bz; block++) {
      const uint8_t *found = slabs[slab].of(block);
      if (!found) continue;
      const int64_t x0 = slab * kBlock, y0 = block / bz % by * kBlock, z0 = block % bz * kBlock;
      const int64_t xs = std::min<int64_t>(kBlock, r.nx - x0), ys = std::min<int64_t>(kBlock, r.ny - y0);
      const int64_t zs = std::min<int64_t>(kBlock, r.nz - z0);
      for (int64_t x = 0; x < xs; x++) {
        for (int64_t y = 0; y < ys; y++) {
          uint8_t *column = r.verdicts + ((x0 + x) * r.ny + y0 + y) * r.nz + z0;
          std::memcpy(column, found + (x * kBlock + y) * kBlock, zs);
        }
      }
    }
  });
}

}  // namespace forecast
