// What crosses the plain C boundary about parts of what moves, and their motion; see `interface.h`.
#pragma once

#include <cstdint>

namespace forecast {

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

// The same asked of some views, side by side.
template <class View>
struct Views {
  int32_t count, threads;
  const View *views;
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
  double knot_share, elapsed_s;     // of the horizon; since errors by this knot were reckoned last
};

// What became of forecasts, and the records that it enters, one after the other. Nodes are those of now; where `before`
// nodes are told of, those of the time of the forecasts.
struct ReckonRequest {
  int64_t nodes, samples;
  int32_t dues, experts, knots, features;
  int32_t turns, learnt_from;             // 1: nodes that turn back are told from others; most nodes to learn from
  double startled, turn;                  // on radii, from where on something new began; m
  double narrower, least_gram;            // share of a radius along the way, m^2
  double memory_s, record_s;              // time constants of the profile, of the records,
  double rise_s, fall_s;                  // of the mixture's error, as it grows and shrinks,
  double learnt_s, step_s;                // and of what is learnt, from whose steps
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

// The scale of errors by their cues: weighted normal equations, those of `ridge` and `prior` beside them.
struct RegressRequest {
  int64_t errors;
  int32_t cues;
  double kept, weight;         // share kept of what was; weight of each error, shared between those
  double upper, ridge;         // above what is expected, and those below
  const double *then, *logs;   // [errors, cues], [errors] logarithms
  const double *prior;         // [cues]
  double *gram, *moment;       // [cues, cues], [cues]
  double *slopes;              // [cues] what is expected now, and then
};

// Where the quantile of past errors over what is expected of them lies.
struct QuantileRequest {
  int64_t errors, bins;
  int32_t cues;
  double lowest, width;                  // of the bins' logarithms
  double fresh;                          // what weights are multiplied by
  double share, slack;                   // that it holds, up to so much weight
  const double *then, *logs, *weights;   // [errors, cues], [errors], [errors]
  const double *slopes;                  // [cues]
};

// How far nodes may be from where they are led. What is of measured velocities is null where they are not.
struct ReachRequest {
  int64_t nodes;
  int32_t horizons, capped;                  // capped: 1: no farther than people get from where measured velocities lead
  double now, last, horizon_s, wary_s;       // s; s ahead; who has been known for less is new; what turned since is wary
  double multiplier, reachable, largest;     // of scales; m
  double person_speed, fallen;               // m/s; m that what falls gets in the last horizon
  double place;                              // m that parts of a flying thing may be from where they were found
  double newcomer_sigmas, most_sigmas;       // standard deviations of the velocity that bounds hold
  double blind;                              // m/s, from which on a velocity is not known
  double astray_at_rest, astray_rise;        // how far people get from where they go straight on: rates over time^1.5,
  double astray, fast, astray_fast;          // and how they grow with the speed, m/s
  const double *horizon, *shares;            // [horizons] s ahead; of the radius at the last
  const double *roots, *power, *start;       // [horizons] root of the share of the last; time^1.5; m that what rests gets
  const double *reached;                     // [horizons] m by acceleration
  const double *scales, *spread;             // [nodes] m, expected errors, and by how much experts differ
  const double *born, *began, *turned;       // [nodes] s
  const double *speeds, *sigmas;             // [nodes] m/s
  const uint8_t *flying, *alone, *falling;   // [nodes] 1: as in Measured
  const double *clear;                       // [nodes] s, as in Measured
  double *radii;                             // [horizons, nodes] m
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

}  // namespace forecast
