// What moved a while ago and stands now.
#pragma once

#include <cstdint>

#include "bits.h"
#include "interface.h"

namespace forecast {

inline void rest(const RestRequest &r) {
  const int words = words_of(r.nz);
  for (int64_t i = 0; i < r.voxels; i++) {
    const int64_t column = r.moving[i] / r.nz, z = r.moving[i] % r.nz, word = column * words + z / 64;
    const uint64_t bit = uint64_t{1} << z % 64;
    if (r.standing[word] & bit) continue;
    r.moved_at[r.moving[i]] = r.stamp;
    r.moved[word] |= bit;
  }
  int64_t count = 0;
  for (int64_t word = 0; word < static_cast<int64_t>(r.nx) * r.ny * words; word++) {
    for (uint64_t left = r.moved[word] & r.standing[word]; left; left &= left - 1) {
      const int64_t voxel = word / words * r.nz + word % words * 64 + __builtin_ctzll(left);
      if (r.moved_at[voxel] > r.oldest) {
        r.resting[count++] = voxel;
      } else {
        r.moved[word] &= ~(left & -left);
      }
    }
  }
  *r.count = count;
}

}  // namespace forecast
