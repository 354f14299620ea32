// What crosses the plain C boundary about voxels; see `interface.h`.
#pragma once

#include <cstdint>

namespace forecast {

// Parts of a grid's voxels, moved and grown once per layer. Voxel (x, y, z) is bit z of column (x, y).
struct GrowRequest {
  int64_t points;
  int32_t layers, parts, nx, ny, nz, threads;
  const int32_t *places;   // [3, points] voxels, also outside the grid
  const int64_t *labels;   // [points] part of each
  const uint8_t *cores;    // [points] 1: makes its voxel a core
  const int32_t *shifts;   // [layers, parts, 3] voxels
  const uint16_t *reaches;  // [layers, parts] radius in quarter voxels
  uint64_t *reached;       // [layers, nx, ny, words] written in the planes told of
  uint64_t *core;          // the same
  int64_t *counts;         // [layers] voxels reached
  int64_t *planes;         // [layers, 2] first x of those planes, and one past the last
};

// Where parts are forecast to be, with rims of their own, and what else may start; both as GrowRequest takes them.
struct AheadRequest {
  int64_t voxels, resting, parts;
  int32_t layers, levels, most_steps, farthest;  // farthest: voxels that anything is moved
  double rim_radius, narrower, part_size, rounding;  // m; share of a radius along the way; m; voxels added to radii
  double voxel_size;
  const double *origin;         // [3] m, of the grid
  const int32_t *places;        // [3, voxels]
  const int64_t *labels;        // [voxels] part of each
  const uint8_t *likely;        // [voxels] 0: of a rim
  const int32_t *rest;          // [3, resting] voxels that may start
  const double *centers;        // [parts, 3] m
  const double *displacements;  // [layers, parts, 3] m
  const double *radii;          // [layers, parts] m
  const uint8_t *turning;       // [parts] 1: held along all of its way
  const double *swerved;        // [layers, parts, 3] m, displacements if accelerations last
  const uint8_t *swerving;      // [parts] 1: held as far as there
  const double *started;        // [layers] m, radii of what may start
  const uint16_t *level;        // [levels] quarter voxels that radii are rounded up to, rising
  GrowRequest grid;             // where they grow: its size, threads and results
};

// Voxels that are set in a mask.
struct PackRequest {
  int64_t voxels;
  int32_t nx, ny, nz;
  const int64_t *indices;  // [voxels] flat, in any order, also twice
  uint64_t *words;         // [nx, ny, words] come zeroed
};

// How many bits are set.
struct TallyRequest {
  int64_t words;
  const uint64_t *mask;  // [words]
};

// The set bits of masks in rising order, mask by mask, and what is told of those that are marked too, and of others.
struct ListRequest {
  int32_t masks, nx, ny, nz, threads;
  uint8_t marked, unmarked;
  const uint64_t *words, *marks;  // [masks, nx, ny, words]
  const int64_t *counts;          // [masks] bits that are set
  const int64_t *planes;          // [masks, 2] first x that may have any, and one past the last; null: all
  uint32_t *indices;              // [sum of counts]
  uint8_t *told;                  // the same
};

// Runs of set bits, from column to column.
struct RunsRequest {
  int32_t nx, ny, nz;
  const uint64_t *words;  // [nx, ny, words]
  uint32_t *runs;         // [n, 2] first and length; room for one in two voxels
  int64_t *count;         // [1]
};

// Where a view sees blocks of voxels.
struct BlockSightings {
  const float *near, *far;  // [blocks] m, of the voxels in each
  const int32_t *windows;   // [blocks, 4] their first and last column, first and last row; last < first for none
  const uint8_t *whole;     // [blocks] 1: all of them lie inside the image
};

// Where a view sees voxels and blocks of them.
struct Table {
  const int32_t *pixels;        // [blocks * 64] of every voxel, block by block; those outside the image come last
  const float *depths;          // [blocks * 64] m
  BlockSightings small, large;  // blocks of 4 x 4 x 4, and of eight of these
};

// What one view says along the ray of every pixel; one more entry stands for outside the image.
struct Sight {
  Table table;
  const float *free_until;    // [pixels + 1] m
  const float *begin, *end;   // [pixels + 1] m, where a measured moving surface explains the ray; null without depth
  const uint8_t *flags;       // [pixels + 1] bits of Flag
  int64_t size;               // pixels + 1
  int32_t width, height;
};

enum Flag : uint8_t { kMoving = 1, kRobot = 2, kSeen = 4, kBeside = 8 };

// What one view shows, and where it is told what that says; one more entry of each stands for outside the image.
struct LookView {
  int32_t width, height;
  double focal, error_pixels;      // by which masks and surfaces may be off
  const float *depth, *backdrop;   // [height, width] m, of what is seen, and of what stands behind; null without depth
  const uint8_t *moving;           // [height, width] 1: moves
  const uint8_t *robot, *valid;    // the same: is the arm, is part of the image; null: none, all
  float *free_until;               // [pixels + 1] m
  float *begin, *end;              // [pixels + 1] m, written where there is depth
  uint8_t *flags;                  // [pixels + 1] bits of Flag
};

// What views say along the rays of their pixels.
struct LookRequest {
  int32_t views, threads, radii, speck;  // smaller blobs than a speck, pixels, are none
  int32_t measured_within;               // pixels about one that is not measured in which its thing is
  int32_t least_blank;                   // pixels of the smallest thing that is not measured anywhere
  const double *radius;                  // [radii] pixels, rising, that widths are told apart by
  double depth_margin, depth_share, thickness, thickness_share, slant;
  const LookView *looks;  // [views]
};

// How deep each pixel sees where nothing that moves is in the way, after one more image.
struct ReviseRequest {
  int32_t width, height, reach;   // pixels within which others tell of those that are not measured
  double step_share;
  float learning_rate, step, unseen, unmeasured, noise, most_noise;
  const float *depth;             // [height, width] m
  const uint8_t *moving, *robot;  // [height, width] 1: moves, is the arm; null: none
  const float *before;            // [height, width] m
  float *after;                   // [height, width] m
  float *filled;                  // [height, width] m, the same where it is not known, but beside
};

// Every voxel, in blocks of 4 x 4 x 4, against every view.
struct CarveRequest {
  int32_t views, nx, ny, nz, threads;
  const Sight *sights;  // [views]
  uint64_t *unknown, *may_move, *likely_moves, *on_arm;  // [nx, ny, words]
};

// What at most `most` boxes are to hold: listed voxels, or the cells of 4 x 4 x 4 that a mask fills a share of.
struct CoverTask {
  int32_t nx, ny, nz, most;
  uint32_t prefix;                  // of the ids of its boxes, above the 24 bits that number their cells
  int64_t several, more;            // voxels
  const uint32_t *voxels, *others;  // [several], [more] flat, in any order, also twice
  const uint64_t *words;            // [nx, ny, words] the mask; null where voxels are listed
  double share;
};

// Boxes about the voxels of octree cells, for some tasks.
struct CoverRequest {
  int64_t tasks, befores;
  int32_t prices, highest_level;
  double loyalty;          // share that the space of a box that was there before counts
  const double *price;     // [prices] rising
  const uint32_t *before;  // [befores] ids of an earlier cover: prefix << 24 | level << 21 | cell on level 0's lattice
  uint32_t *ids;           // [boxes] the same of this one, task by task; room for as many as all tasks may have
  int64_t *lower, *upper;  // [boxes, 3] first and last voxel
  int64_t *counts;         // [tasks] boxes
  const CoverTask *task;   // [tasks]
};

// What may be hidden in unknown space, one state after the other.
struct HideRequest {
  int32_t nx, ny, nz, width;                     // voxels across a hand, at most 64
  int32_t hop, way, fewest;                      // cells: got on since before; on through ways; that a hand takes up
  float elapsed_s, rest_s, never;                // since before, s; what was reached longer ago lies still, s
  const uint64_t *unknown, *moving, *standing;   // [nx, ny, words]
  float *ages;                                   // [cells of 2 x 2 x 2] s since each was reached, before and after
  uint64_t *reached;                             // [columns of cells, words] where that is not `never`
  uint64_t *maybe_full;                          // [nx, ny, words] not known to be empty, before and after
  uint64_t *reachable;                           // [nx, ny, words] something may come out
};

// What cameras do not see, and what of it something may hide in.
struct ConcealRequest {
  int64_t words;
  const uint64_t *unknown, *may_move, *likely_moves, *on_arm, *standing;  // [words]; `on_arm` null: none
  uint64_t *hiding;  // [words] unknown, and nothing stands there
  uint64_t *unseen;  // [words] told as unknown, before and after
};

// Which of the voxels that stand moved of late, and did not stand then.
struct RestRequest {
  int32_t nx, ny, nz;
  int64_t voxels, stamp, oldest;  // ns, of now, and from when on what moved counts
  const int64_t *moving;          // [voxels] flat, in the grid
  const uint64_t *standing;       // [nx, ny, words]
  int64_t *moved_at;              // [nx, ny, nz] ns, before and after
  uint64_t *moved;                // [nx, ny, words] where that may be late enough, before and after
  int64_t *resting;               // [n] flat, rising; room for all voxels
  int64_t *count;                 // [1] n
};

// The voxels that hold points of measured surfaces, `finer` along each side of a pixel.
struct MarkRequest {
  int32_t width, height, finer, nx, ny, nz;
  double voxel_size;
  const double *origin;         // [3] m
  const float *depth;           // [height, width] m
  const uint8_t *chosen;        // [height, width] 1: measures such a surface
  const float *across, *down;   // [width * finer], [height * finer] pixels from the principal point
  const float *focal;           // [2] pixels
  const float *T_base_cam;      // [3, 4]
  uint8_t *marked;              // [nx, ny, nz] 1 where it is; the others stay as they are
};

// The voxels whose middles lie within some capsules.
struct TakeRequest {
  int64_t capsules;
  int32_t nx, ny, nz;
  double voxel_size;
  const double *origin;         // [3] m
  const double *ends, *radii;   // [capsules, 2, 3], [capsules] m
  uint64_t *taken;              // [nx, ny, words] comes zeroed
};

}  // namespace forecast
