// What crosses the plain C boundary: these structs are mirrored field by field in kernel_requests.py.
#pragma once

#include <cstdint>

namespace cell {

constexpr int32_t kInterfaceVersion = 1;

enum Form : int32_t { kSphere, kCapsule, kBox };  // in the order of `shapes.Form`

enum Pattern : int32_t { kPlain, kChecker, kStripes, kTiles, kWood, kSpeckle, kPatches };  // of `textures.PATTERNS`

// What surfaces look like, the same for all solids; see `textures.py`.
struct Patterns {
  int32_t lattice;             // side of `volume`, a power of two
  float grain;                 // cells per element
  float joint, shades;         // of tiles: in tiles; share of the second colour
  float wood_distortion, wood_rings;  // elements; radians per element
  const float *wood_grain;     // [3] cells per element
  const float *shares;         // [patterns, 2] of the figure and of the grain in the mix
  const float *volume;         // [lattice, lattice, lattice] 0 to 1
};

struct Lighting {
  int32_t lamps;
  float ambient;
  const float *lamp;  // [lamps, 4] strength, and the direction towards it
};

// Solids drawn into an image that may show others already. S solids, lengths in m.
struct CastRequest {
  int32_t width, height, solids;
  float texture_depth;      // m under the surface
  const float *rays;        // [3, height, width] directions, 1 along the optical axis
  const int32_t *kinds;     // [S, 3] form, pattern, owner
  const int32_t *rects;     // [S, 4] columns and rows that may show it: first, and one past the last
  const float *lengths;     // [S, 3] box: half extents; else radius and half the distance of the end centres
  const float *rotations;   // [S, 3, 3] from a solid's frame
  const float *origins;     // [S, 3] the camera's centre in a solid's frame
  const float *looks;       // [S, 7] both colours, 0 to 255, and the scale
  Patterns patterns;
  Lighting lighting;
  uint8_t *rgb;     // [height, width, 3] drawn into
  float *depth;     // [height, width] the same; 0 where no solid is
  int16_t *owners;  // [height, width] the same
};

// What a sensor makes of colours that its lens has blurred.
struct ColourRequest {
  int64_t levels;
  float sigma;             // of the noise, levels
  const uint8_t *blurred;  // [levels]
  const float *noise;      // [levels] of standard deviation 1
  uint8_t *sensed;         // [levels]
};

// What it makes of depth.
struct DepthRequest {
  int64_t pixels;
  float sigma_mm;                // of the noise at 1 m
  float dropout, edge_dropout;   // chances of a pixel to be lost
  float step, shortest;          // depth that changes by more than this share of it, or of this (m), is an edge
  float farthest_mm;             // that can be told
  const float *depth;            // [pixels] m; 0: unknown
  const float *lowest, *highest;  // [pixels] of it about each pixel
  const float *noise;            // [pixels] of standard deviation 1
  const float *chance;           // [pixels] 0 to 1
  uint16_t *sensed_mm;           // [pixels] 0: unknown
};

}  // namespace cell
