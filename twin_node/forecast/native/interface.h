// What crosses the plain C boundary: these structs are mirrored field by field in kernels.py.
#pragma once

#include <cstdint>

namespace forecast {

constexpr int32_t kInterfaceVersion = 24;

enum Status : int32_t { kOk = 0, kOutOfMemory = 1, kOutside = 2 };

// Parts of a grid's voxels, moved and grown once per layer. Voxel (x, y, z) is bit z of column (x, y).
struct GrowRequest {
  int64_t points;
  int32_t layers, parts, nx, ny, nz, threads;
  const int32_t *places;   // [3, points] voxels, also outside the grid
  const int64_t *labels;   // [points] part of each
  const uint8_t *cores;    // [points] 1: makes its voxel a core
  const int32_t *shifts;   // [layers, parts, 3] voxels
  const uint8_t *reaches;  // [layers, parts] radius in quarter voxels
  uint64_t *reached;       // [layers, nx, ny, words] comes zeroed
  uint64_t *core;          // the same
  int64_t *counts;         // [layers] voxels reached
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

// The set bits of masks in rising order, mask by mask, and which of them are marked too.
struct ListRequest {
  int32_t masks, nx, ny, nz, threads;
  const uint64_t *words, *marks;  // [masks, nx, ny, words]
  const int64_t *counts;          // [masks] bits that are set
  uint32_t *indices;              // [sum of counts]
  uint8_t *marked;                // the same
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
  const double *radius;                  // [radii] pixels, rising, that widths are told apart by
  double depth_margin, depth_share, thickness, thickness_share, slant;
  const LookView *looks;  // [views]
};

// How deep each pixel sees where nothing that moves is in the way, after one more image.
struct ReviseRequest {
  int32_t width, height, reach;   // pixels within which others tell of those that are not measured
  double step_share;
  float learning_rate, step, unseen, unmeasured;
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
  uint64_t *unknown, *may_move, *likely_moves, *on_arm;  // [nx, ny, words] come zeroed
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
  int32_t nx, ny, nz, width, reach;              // voxels of a hand, below 64; cells that things move since before
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

// The parts that voxels are of: one per cell of `side` voxels that holds any, in the order of cells.
struct SplitRequest {
  int64_t voxels;
  int32_t nx, ny, nz, side;
  const int64_t *indices;  // [voxels] flat
  int32_t *places;         // [3, voxels] coordinates
  int64_t *labels;         // [voxels] part of each
  double *sums;            // [parts, 4] of coordinates, and of voxels; room for as many as there are voxels
  int64_t *count;          // [1] parts
};

// Which points hang together: those that are no further apart than `reach`.
struct LinkRequest {
  int64_t points;
  double reach;           // m
  const double *centers;  // [points, 3] m
  int64_t *pieces;        // [points] piece of each, in the order of their first points
};

// The things that parts are of: parts that hang together. Rims hang on the nearest part that is more than a rim.
struct GatherRequest {
  int64_t voxels, parts;
  double reach;            // m
  const int32_t *places;   // [3, voxels] coordinates
  const int64_t *labels;   // [voxels] part of each
  const uint8_t *likely;   // [voxels] 0: of a rim
  const double *centers;   // [parts, 3] m
  int64_t *things;         // [parts] thing of each; -1 for rims that hang on nothing
  int64_t *extents;        // [things, 13] voxels that are no rims; their least, greatest, summed, and squared and summed
                           // coordinates; room for as many as there are parts
  int64_t *count;          // [1] things
};

// One image of what moves: what it is compared by with the image before.
struct SeeRequest {
  int32_t width, height, painted, smallest;  // brightness of all that does not move; pixels of the smallest blob
  double compact;                            // share of the square about it that a blob fills at least
  const uint8_t *rgb;                        // [height, width, 3]
  const uint8_t *moving;                     // [height, width] 0 or 1
  uint8_t *grey, *near;                      // [height, width] brightness; 1: moves, or is beside what does
  int32_t *labels;                           // [height, width] blob of each such pixel, from 1 on; 0 for all others
  double *blobs;                             // [n, 4] of compact blobs: label, pixels, middle; room for most that fit
  int64_t *found;                            // [5] n; first column, one past the last, first row, one past the last
};

// Voxels of parts that a view shows to move, and how pixels move with the parts.
struct ShowRequest {
  int64_t voxels, parts;
  int32_t width, height;
  float part_size;               // m
  double least_depth;            // m, of the middle of a part
  double focal[2], viewmat[12];  // pixels; base to camera, row by row
  const int64_t *places;         // [voxels] in the tables
  const int64_t *labels;         // [voxels] part of each
  const int32_t *table_pixels;   // flat pixel of every place; those outside the image come after its last
  const float *table_depths;     // m
  const uint8_t *moving;         // [height, width] 0 or 1
  const double *centers;         // [parts, 3] m
  int64_t *pixels, *shown_labels, *count;  // [voxels], [voxels], [1]
  double *jacobian;              // [parts, 2, 3] pixels per metre
};

// One image, as `see` tells of it, and its depths.
struct SeenImage {
  const uint8_t *grey, *near;  // [height, width]
  const int32_t *labels;       // [height, width]
  const double *blobs;         // [n, 4]
  const float *depth;          // [height, width] m; null where it is not measured in both images
  int64_t count;               // n
};

// What two images of a view show of parts: means over pixels.
struct TellRequest {
  int64_t voxels, parts, fewest;              // measured voxels from which a part's depth is known
  int32_t width, height, alike;               // difference in brightness from which pixels show different things
  int32_t left, top, columns, rows;           // where the flow is known
  float flow_noise, most_receded;             // pixels, m
  double known_share, least;                  // of a part's pixels that must be found; least that sums are divided by
  double same_area, found_from, found_until;  // how much larger, and how many widths further, blobs may be than before
  double flow_sigma, flight_sigma;            // pixels
  double fast, lost;                          // m, pixels: flow is as good as noise where fast things go further
  SeenImage now, before;
  const float *flow;                          // [rows, columns, 2] pixels back to where it was before
  const int64_t *pixels, *labels;             // [voxels]
  const double *jacobian;                     // [parts, 2, 3] pixels per metre
  double *shifts, *variances;                 // [parts, 2] pixels, [parts] pixels^2, infinite where nothing is known
  uint8_t *shown;                             // [parts]
  double *receded, *depths;                   // [parts] m; 0 and infinite where they are not known
};

// What one view says of the motion of parts since its last image.
struct SolveView {
  const double *jacobian;   // [parts, 2, 3] pixels per metre
  const double *shifts;     // [parts, 2] pixels
  const double *variances;  // [parts] pixels^2
  const double *receded;    // [parts] m by which they went away from the camera
  const double *depths;     // [parts] m
  const uint8_t *shown;     // [parts]
  double elapsed_s;
  double axis[3];  // of the camera
};

// Velocities of parts that all views agree on best, beside what was expected of them and of wholes.
struct SolveRequest {
  int64_t parts;
  int32_t views, turns;
  double most;                         // standard deviation, m/s
  double depth_sigma, depth_share;     // error of changes of depth, m, and as a share of the depth
  double far, astray;                  // pixels that flow finds; share of the way that it may be off
  const SolveView *seen;
  const double *prior, *prior_sigmas;  // [parts, 3] m/s, [parts] m/s
  const double *whole, *whole_sigmas;  // [parts, 3] m/s, [parts] m/s
  const uint8_t *falling;              // [parts] 1: goes as the whole
  double *velocities, *sigmas;         // [parts, 3] m/s, [parts] m/s
  uint8_t *lost;                       // [views] 1: some part went further than its flow finds, and another way
};

// Where experts, and their mixture, lead nodes in some times. The gravity, line, parabola and falling are of History.
struct LeadRequest {
  int64_t nodes;
  int32_t horizons, features;
  double bounce;                         // share of its speed that what bounces keeps
  const double *here;                    // [nodes, 3] m
  const double *line;                    // [nodes, 3] m/s
  const double *parabola;                // [2, nodes, 3] m/s, m/s^2
  const double *falling;                 // [nodes, 3] m/s
  const double *floors;                  // [nodes] m, the heights that they bounce from
  const double *seen;                    // [nodes, 3, features] of the autoregression
  const double *learnt;                  // [horizons, features] its weights
  const double *weights;                 // [experts, nodes] in the mixture
  const double *horizon, *travelled;     // [horizons] s, and for how long at full speed what slows down goes as far
  const double *gravity;                 // [3] m/s^2
  double *single, *mixed;                // [experts, horizons, nodes, 3], [horizons, nodes, 3] m
};

// What experts go by, how they are weighed, and where they lead nodes; what of it is of History is told there.
struct OutlookRequest {
  int64_t nodes, samples, near;                 // near: nodes that the nearer average is taken over
  int32_t horizons, steps, seen;                // seen: features of the autoregression, three for each step
  double line_s, parabola_s, filled, step_s;    // spans of fits, and the share of them that samples fill; s
  double near_scale, body_scale, cell;          // m
  double pooled, sharpness, indifference;       // share of those around in records; of `mix`; m
  double bounce, least;                         // share of its speed that what bounces keeps; of cues, m
  const double *times, *positions;              // [samples] s, [samples, nodes, 3] m
  const double *distances;                      // [nodes, near] m
  const int64_t *nearest;                       // [nodes, near]
  const double *squared, *errors;               // [experts, nodes] m^2, [nodes] m, the records
  const double *trust;                          // [experts]
  const int64_t *alone;                         // [nodes] the expert that leads a node alone; negative for none
  const double *floors;                         // [nodes] m
  const double *learnt;                         // [horizons, seen] weights of the autoregression
  const double *horizon, *travelled, *gravity;  // as of LeadRequest
  double *line, *parabola, *falling;            // [nodes, 3], [2, nodes, 3], [nodes, 3]
  double *features;                             // [nodes, 3, seen]
  double *shares;                               // [experts, nodes] weights by the records
  double *single, *mixed;                       // as of LeadRequest
  double *cues;                                 // [nodes, 7] of errors at the last horizon
};

// Forecasts of `before` nodes for a time that has come.
struct DueForecast {
  int64_t before, knot;
  const int64_t *rows;              // [nodes] of each node's ancestor; negative for none
  const double *features;           // [before, 3, features] of the autoregression
  const double *places;             // [experts, knots, before, 3] m
  const double *mixed;              // [knots, before, 3] m
  const double *radii;              // [before] m
  const uint8_t *turning;           // [before] 1: held along all of its way
  double valid_at, time;            // s, that time, and that of the forecasts
  double factor, grown_s;           // on their radii; s
  double knot_share, kept, rate;    // of the horizon, of what the profile was; at which records follow
  double rise, fall;                // rates of the mixture's error, as it grows and shrinks
  double learnt, weight;            // share kept of what was learnt, and weight of all these nodes together
};

// What became of forecasts, and the records that it enters, one after the other. Nodes are those of now; where `before`
// nodes are told of, those of the time of the forecasts.
struct ReckonRequest {
  int64_t nodes, samples;
  int32_t dues, experts, knots, features;
  int32_t turns, learnt_from;             // 1: nodes that turn back are told from others; most nodes to learn from
  double startled, turn;                  // on radii, from where on something new began; m
  double narrower, least_gram;            // share of a radius along the way, m^2
  const double *times;                    // [samples] s, rising, the last is now
  const double *positions;                // [samples, nodes, 3] m
  double *profile;                        // [knots] m, mean errors
  double *squared;                        // [experts, nodes] m^2
  double *errors, *began, *turned;        // [nodes] m, s, s
  int64_t *judged;                        // [nodes]
  double *gram, *moment;                  // [knots, features, features], [knots, features] of the autoregression
  int64_t *found;                         // [dues, nodes] rows of the ancestors of those nodes that have one
  double *moved, *wrong;                  // [dues, nodes, 3], [dues, nodes] m, of these nodes
  uint8_t *grown;                         // [dues, nodes] 1: what they do began long enough ago, of these nodes
  int64_t *left;                          // [dues] how many these are
  const DueForecast *due;                 // [dues]
};

// The nearest of other points to each of some, group by group.
struct NearestRequest {
  int64_t groups, points, others, wanted;
  double within;                // m; what is as far away is none of them
  const double *asked, *among;  // [points, 3], [groups, others, 3] m
  double *distances;            // [groups, points, wanted] m, rising; infinite where there are no more
  int64_t *rows;                // the same, among the others; their number where there are no more
};

// What a view with depth shows of what moves.
struct SurfaceView {
  int32_t width, height;
  const float *depth;             // [height, width] m
  const uint8_t *moving;          // [height, width] 1: moves
  const double *K, *T_base_cam;   // [3, 3], [4, 4]
};

// Points of its surface that lie in the inner one of two grids, view by view.
struct SurfaceRequest {
  int64_t forecasts, voxels, views;
  double voxel_size;
  const int32_t *inner_dims, *outer_dims;      // [3]
  const double *inner_origin, *outer_origin;   // [3] m
  const int64_t *forecast;                     // [forecasts] voxels of the inner grid
  const int64_t *indices, *labels;             // [voxels] those of parts in the outer grid, rising; part of each
  int64_t *parts;                              // [points] part that holds each; -1 for none; room for all pixels
  uint8_t *foreseen;                           // [points] 1: its voxel was forecast
  int64_t *count;                              // [1] points
  const SurfaceView *seen;                     // [views]
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
