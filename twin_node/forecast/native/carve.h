// What the views of a rig say about every voxel.
#pragma once

#include <algorithm>
#include <memory>
#include <vector>

#include "../../native/crew.h"
#include "bits.h"
#include "interface.h"
#include "overview.h"

namespace forecast {

constexpr int kBlock = 4;  // voxels along a side of a block
constexpr int kVoxels = kBlock * kBlock * kBlock;
constexpr int kParts = 8;  // blocks of a large one

// Two views must show the same to be believed where no surface is measured.
constexpr int kWitnesses = 2;

// Masks of the voxels of one block, x before y before z.
struct Found {
  uint64_t unknown, may_move, likely_moves, on_arm;
};

// Of numbers that are 0 or 1.
inline uint64_t as_bits(const int32_t *flags) {
  uint8_t bytes[kVoxels];
  for (int i = 0; i < kVoxels; i++) bytes[i] = static_cast<uint8_t>(flags[i]);
  uint64_t bits = 0;
  for (int i = 0; i < kVoxels; i += 8) bits |= eight_bits(bytes + i) << i;
  return bits;
}

// What the views say of the voxels of one block, which lie side by side in the tables: vectors of `kVoxels`.
class BlockVerdicts {
 public:
  using Size = BlockSightings Table::*;  // &Table::small or &Table::large

  BlockVerdicts(
      const CarveRequest &request, const std::vector<std::unique_ptr<Overview>> &overviews,
      const std::vector<std::vector<int32_t>> &flags)
      : r_(request), overviews_(overviews), flags_(flags), dividing_(kParts * request.views) {}

  // Whether some view frees all of a block. Neighbours are often freed by the same one.
  bool freed_as_a_whole(Size size, int64_t block) {
    for (int turn = 0; turn < r_.views; turn++, likeliest_ = (likeliest_ + 1) % r_.views) {
      const BlockSightings &blocks = r_.sights[likeliest_].table.*size;
      const Overview &overview = *overviews_[likeliest_];
      const auto window = [&] { return overview.window(blocks.windows + 4 * block); };
      if (blocks.whole[block] && blocks.far[block] < overview.least(window())) return true;
    }
    return false;
  }

  // Whether no view frees or explains any of a block.
  bool unknown_as_a_whole(Size size, int64_t block) {
    begin_anew();
    return !divided(size, block) && dividing_count_ == 0;
  }

  // A block that is not freed as a whole: the views that may free parts of it, and whether any may explain the rest.
  struct Undecided {
    int64_t block;
    int first, end;  // of `dividing_`
    bool is_explicable;
  };

  void begin_anew() { dividing_count_ = 0; }

  // Good until the next beginning, for up to `kParts` blocks. What the tables say of its voxels is on its way from then on.
  Undecided undecided(int64_t block) {
    const int first = dividing_count_;
    const bool is_explicable = divided(&Table::small, block);
    for (int k = first; k < dividing_count_; k++) {
      const Table &table = r_.sights[dividing_[k]].table;
      for (int64_t i = block * kVoxels; i < (block + 1) * kVoxels; i += kLine) {
        __builtin_prefetch(table.pixels + i);
        __builtin_prefetch(table.depths + i);
      }
    }
    return {block, first, dividing_count_, is_explicable};
  }

  Found of(const Undecided &undecided) {
    const int64_t block = undecided.block;
    if (freed_voxel_by_voxel(undecided)) return {0, 0, 0, 0};
    if (!undecided.is_explicable) return {as_bits(open_), 0, 0, 0};
    for (int i = 0; i < kVoxels; i++) moving_[i] = robot_[i] = seen_[i] = surface_[i] = beside_[i] = 0;
    for (int v = 0; v < r_.views; v++) look(r_.sights[v], flags_[v].data(), block * kVoxels);
    for (int i = 0; i < kVoxels; i++) {
      const int32_t explained = (moving_[i] >= kWitnesses) | surface_[i];
      const int32_t itself = (robot_[i] >= kWitnesses) & (robot_[i] == seen_[i]);
      on_arm_[i] = open_[i] & (explained == 0) & itself;
      unknown_[i] = open_[i] & (explained == 0) & (itself == 0);
      may_move_[i] = open_[i] & (explained != 0);
      likely_moves_[i] = may_move_[i] & (beside_[i] == 0);
    }
    return {as_bits(unknown_), as_bits(may_move_), as_bits(likely_moves_), as_bits(on_arm_)};
  }

 private:
  static constexpr int64_t kLine = 64 / sizeof(float);

  // Adds the views that may free parts of a block, and says whether any may explain what is left.
  bool divided(Size size, int64_t block) {
    int moving = 0, robot = 0, surface = 0;
    for (int v = 0; v < r_.views; v++) {
      const BlockSightings &blocks = r_.sights[v].table.*size;
      const Overview &overview = *overviews_[v];
      const int32_t *ends = blocks.windows + 4 * block;
      Extremes all = overview.outside();
      if (ends[0] <= ends[1]) all = joined(all, overview.over(overview.window(ends)));
      if (blocks.near[block] < all.most) dividing_[dividing_count_++] = v;
      moving += (all.flags & kMoving) != 0;
      robot += (all.flags & kRobot) != 0;
      surface |= (all.flags & kSurface) && overview.surface().reaches(ends, blocks.near[block], blocks.far[block]);
    }
    return moving >= kWitnesses || robot >= kWitnesses || surface;
  }

  bool freed_voxel_by_voxel(const Undecided &undecided) {
    const int64_t first = undecided.block * kVoxels;
    for (int i = 0; i < kVoxels; i++) open_[i] = 1;
    for (int k = undecided.first; k < undecided.end; k++) {
      const int v = dividing_[k];
      const int32_t *pixels = r_.sights[v].table.pixels + first;
      const float *depths = r_.sights[v].table.depths + first, *free_until = r_.sights[v].free_until;
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
    const int32_t *pixels = sight.table.pixels + first;
    for (int i = 0; i < kVoxels; i++) {
      const int32_t shown = flags[pixels[i]];
      moving_[i] += (shown & kMoving) != 0;
      robot_[i] += (shown & kRobot) != 0;
      seen_[i] += (shown & kSeen) != 0;
      beside_[i] |= shown & kBeside;
    }
    if (!sight.begin) return;
    const float *depths = sight.table.depths + first;
    for (int i = 0; i < kVoxels; i++) {
      surface_[i] |= (sight.begin[pixels[i]] <= depths[i]) & (depths[i] < sight.end[pixels[i]]);
    }
  }

  const CarveRequest &r_;
  const std::vector<std::unique_ptr<Overview>> &overviews_;
  const std::vector<std::vector<int32_t>> &flags_;
  std::vector<int> dividing_;  // views that may free parts of blocks, block by block: so many
  int dividing_count_ = 0;
  int32_t open_[kVoxels], moving_[kVoxels], robot_[kVoxels], seen_[kVoxels], surface_[kVoxels], beside_[kVoxels];
  int32_t unknown_[kVoxels], may_move_[kVoxels], likely_moves_[kVoxels], on_arm_[kVoxels];
  int likeliest_ = 0;
};

// A grid in blocks, and in large ones of two by two by two of these.
struct BlockLattice {
  int64_t x, y, z;

  BlockLattice(int64_t nx, int64_t ny, int64_t nz, int64_t side)
      : x((nx + side - 1) / side), y((ny + side - 1) / side), z((nz + side - 1) / side) {}
  int64_t flat(int64_t i, int64_t j, int64_t k) const { return (i * y + j) * z + k; }
};

// Carves the large blocks with the same place along x.
class Slab {
 public:
  Slab(const CarveRequest &request, BlockVerdicts &verdicts, int64_t number)
      : r_(request), verdicts_(verdicts), number_(number), small_(r_.nx, r_.ny, r_.nz, kBlock),
        large_(r_.nx, r_.ny, r_.nz, kLarge) {}

  void carve() {
    clear();
    for (int64_t y = 0; y < large_.y; y++) {
      for (int64_t z = 0; z < large_.z; z++) {
        const int64_t block = large_.flat(number_, y, z);
        if (verdicts_.freed_as_a_whole(&Table::large, block)) continue;
        if (verdicts_.unknown_as_a_whole(&Table::large, block)) {
          for_parts(y, z, [&](const Corner &at) { write(r_.unknown, ~uint64_t{0}, at); });
        } else {
          carve(y, z);
        }
      }
    }
  }

 private:
  static constexpr int kLarge = 2 * kBlock;

  // First voxel of a block.
  struct Corner {
    int64_t x, y, z;
  };

  void clear() const {
    const int64_t row = static_cast<int64_t>(r_.ny) * words_of(r_.nz), first = number_ * kLarge;
    const int64_t planes = std::min<int64_t>(kLarge, r_.nx - first);
    for (uint64_t *mask : {r_.unknown, r_.may_move, r_.likely_moves, r_.on_arm}) {
      std::fill_n(mask + first * row, planes * row, 0);
    }
  }

  template <class Work>
  void for_parts(int64_t y, int64_t z, const Work &work) const {
    for (int64_t part = 0; part < kParts; part++) {
      const int64_t i = 2 * number_ + part / 4, j = 2 * y + part / 2 % 2, k = 2 * z + part % 2;
      if (i < small_.x && j < small_.y && k < small_.z) work(Corner{i * kBlock, j * kBlock, k * kBlock});
    }
  }

  // What the tables say of voxels is asked for block by block, and read when the large block's last has been asked for:
  // one after the other would wait for memory every time.
  void carve(int64_t y, int64_t z) {
    BlockVerdicts::Undecided waiting[kParts];
    Corner corners[kParts];
    int count = 0;
    verdicts_.begin_anew();
    for_parts(y, z, [&](const Corner &at) {
      const int64_t block = small_.flat(at.x / kBlock, at.y / kBlock, at.z / kBlock);
      if (verdicts_.freed_as_a_whole(&Table::small, block)) return;
      waiting[count] = verdicts_.undecided(block), corners[count++] = at;
    });
    for (int part = 0; part < count; part++) {
      const Found found = verdicts_.of(waiting[part]);
      if (found.unknown) write(r_.unknown, found.unknown, corners[part]);
      if (found.may_move) write(r_.may_move, found.may_move, corners[part]);
      if (found.likely_moves) write(r_.likely_moves, found.likely_moves, corners[part]);
      if (found.on_arm) write(r_.on_arm, found.on_arm, corners[part]);
    }
  }

  // Enters what was found of a block in a mask of the grid, which it may stand out of.
  void write(uint64_t *mask, uint64_t found, const Corner &at) const {
    const int64_t x0 = at.x, y0 = at.y, z0 = at.z, words = words_of(r_.nz);
    const int64_t xs = std::min<int64_t>(kBlock, r_.nx - x0), ys = std::min<int64_t>(kBlock, r_.ny - y0);
    const uint64_t inside = (uint64_t{1} << std::min<int64_t>(kBlock, r_.nz - z0)) - 1;
    for (int64_t x = 0; x < xs; x++) {
      for (int64_t y = 0; y < ys; y++) {
        const uint64_t column = found >> (x * kBlock + y) * kBlock & inside;
        mask[((x0 + x) * r_.ny + y0 + y) * words + z0 / 64] |= column << z0 % 64;
      }
    }
  }

  const CarveRequest &r_;
  BlockVerdicts &verdicts_;
  const int64_t number_;
  const BlockLattice small_, large_;
};

inline void conceal(const ConcealRequest &r) {
  for (int64_t i = 0; i < r.words; i++) {
    const uint64_t rims = r.may_move[i] & ~r.likely_moves[i], behind = (r.on_arm ? r.on_arm[i] : 0) | (rims & r.unseen[i]);
    r.hiding[i] = r.unknown[i] & ~r.standing[i];
    r.unseen[i] = (r.unknown[i] | behind) & ~r.standing[i];
  }
}

inline void carve(const CarveRequest &r) {
  std::vector<std::vector<int32_t>> flags(r.views);  // words are gathered many at a time, bytes are not
  std::vector<std::unique_ptr<Overview>> overviews(r.views);
  crew::parallel_for(r.threads, r.views, [&](int64_t v) {
    flags[v].assign(r.sights[v].flags, r.sights[v].flags + r.sights[v].size);
    overviews[v] = std::make_unique<Overview>(r.sights[v]);
  });
  std::vector<BlockVerdicts> verdicts((r.nx + 2 * kBlock - 1) / (2 * kBlock), BlockVerdicts(r, overviews, flags));
  crew::parallel_for(r.threads, static_cast<int64_t>(verdicts.size()), [&](int64_t slab) {
    Slab(r, verdicts[slab], slab).carve();
  });
}

}  // namespace forecast
