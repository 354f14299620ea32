// How much each Gaussian of a scene shows in an image: its blend weights, summed over the pixels.
#pragma once

#include "rasterizer.h"

namespace splat {

// Puts the blend weights of one tile's splats, summed over its pixels, into their slots, a float each.
inline void weigh_tile(Image &image, const Tile &tile, float max_alpha) {
  Vec transmittance[kBlocks];
  BlockSet alive = image.live[tile.index];
  for (int block = 0; block < kBlocks; block++) {
    transmittance[block] = (alive >> block & 1) ? initial_transmittance(image, tile, block) : broadcast(-1.f);
  }
  const Vec limit = broadcast(max_alpha), cut = broadcast(kTransmittanceCut);
  for (int at = image.tile_begin[tile.index]; at < image.tile_begin[tile.index + 1]; at++) {
    const Footprint &shape = image.splats[image.tile_splat[at]].shape;
    const LocalFootprint footprint(shape, tile);
    Vec shown{};
    for (BlockSet left = blocks_of_cells(cells_reached(shape, footprint)) & alive; left; left &= left - 1) {
      const int block = __builtin_ctzll(left);
      const Coverage c = cover(footprint, block, transmittance[block]);
      if (!any(c.hit)) continue;
      const Share share(c, transmittance[block], min(exp2_nonpositive(c.exponent), limit), cut);
      shown += share.weight;
      advance(transmittance[block], share.behind, c.hit, share.drawn, block, alive);
    }
    float sums[4];
    sum4(shown, Vec{}, Vec{}, Vec{}, sums);
    image.slot_gradient[image.tile_slot[at]] = sums[0];
  }
}

// Writes the `weights` [N] of a scene's Gaussians in its one image; no channel is drawn.
inline Status weigh(Workspace &w, const Request &r, float *weights) {
  const Status found = forward(w, r);
  if (found != kOk) return found;
  const std::lock_guard<std::mutex> lock(w.in_use);
  Image &image = *w.images[0];
  image.slot_gradient.reserve(image.intersections);
  over_tiles(r, w, [&](int, int index) { weigh_tile(image, Tile(image, index, mask_of(r, 0)), r.max_alpha); });
  std::fill_n(weights, r.gaussians, 0.f);
  for (int row = 0; row < image.visible; row++) {
    float &weight = weights[image.id[row]];
    for (int slot = image.slot_begin[row]; slot < image.slot_begin[row + 1]; slot++) weight += image.slot_gradient[slot];
  }
  return kOk;
}

}  // namespace splat
