// What crosses the plain C boundary about points, nodes, what they carry, and what is born; see `interface.h`.
#pragma once

#include <cstdint>

namespace model {

constexpr int kColumns = 14;  // of a row of a store's values: mean, quat, log scale, logit, colour

// Nodes at some times from now.
struct AdvanceRequest {
  int64_t times, nodes;
  const double *seconds;                              // [times]
  const double *positions, *quats, *velocities, *turns;  // [nodes, 3], [nodes, 4], [nodes, 3] m/s, [nodes, 3] rad/s
  double *advanced, *rotated;                         // [times, nodes, 3], [times, nodes, 4] written
};

// Nodes as they are and as they were.
struct MovedRequest {
  int64_t nodes;
  const double *positions, *quats, *positions_then, *quats_then;  // [nodes, 3], [nodes, 4]
  double *moved;                                                  // [nodes, 6] m and rad, written
};

// Nodes at some times, whose rotations are wanted as matrices.
struct CarryRequest {
  int64_t times, nodes;
  const double *positions, *quats;   // [times, nodes, 3], [times, nodes, 4]
  float *turns, *shifts, *products;  // [times, nodes + 1, 3, 3], [times, nodes + 1, 3], [times, nodes + 1, 4, 4] written
};

// Nodes as they are.
struct NodesNow {
  const double *positions, *quats, *velocities, *turns;  // [nodes, 3], [nodes, 4], [nodes, 3] m/s, [nodes, 3] rad/s
};

// Gaussians of a store, in the order in which they are published.
struct PublishRequest {
  int64_t count;
  int32_t threads;
  const int64_t *rows;                      // [count]
  const float *values;                      // [capacity, 14]
  const int64_t *carriers, *id_of;          // [capacity]
  const uint8_t *tier_of;                   // [capacity]
  const int64_t *position_of;               // [nodes] where each is published, -1 for nowhere
  NodesNow nodes;
  float *means, *quats, *scales, *opacities, *rgb, *velocities;  // [count, ...] written, as the next ones
  uint8_t *tiers;
  uint32_t *ids;
  int32_t *published;
};

// What is seen of a cloud's Gaussians.
struct Cloud {
  int64_t count;
  const float *means, *scales, *opacities, *rgb;  // [count, 3] m, [count, 3] m, [count], [count, 3]
  const uint8_t *tiers;
  const uint32_t *ids;
};

// A cloud beside an older one, whose ids ascend; see `cloud_updates.py`.
struct ChangeRequest {
  Cloud now, then;
  float colour, opacity, size;  // differences from which on it is another; of sizes and places as shares of a size
  uint8_t standing;             // tier
  uint8_t *changed, *gone;      // [now.count], [then.count] written
};

struct ExtentRequest {
  int64_t count, nodes;
  const int64_t *rows, *carriers;       // [count], [capacity]
  const float *values;                  // [capacity, 14]
  double *centroids, *weights, *radii;  // [nodes, 3], [nodes], [nodes] written
};

// Gaussians of a store that nodes carry, to be dealt out to the cubes of these.
struct CellRequest {
  int64_t count, axis_bits;
  double side;                                    // m
  const int64_t *rows, *carriers, *founders;      // [count], [capacity], [capacity]
  const float *values, *means;                    // [capacity, 14], [count, 3] in the base frame
  int64_t *keys, *nodes, *of;                     // [count] written: as many as cells of the first two
  double *centres, *rgb;                          // [count, 3] written: as many as cells
  int64_t *found;                                 // [1] written: how many cells
};

// How far Gaussians have crept in the frames of their nodes; what is remembered of each row is brought up to date.
struct CreepRequest {
  int64_t count, cells, capacity;
  const int64_t *rows, *ids;                 // [count], [capacity]
  const float *values;                       // [capacity, 14]
  const int64_t *of, *homes;                 // [count] cells, [cells] ids of their nodes
  int64_t *known_ids, *known_homes;          // [capacity]
  float *known_means;                        // [capacity, 3]
  double *crept;                             // [cells, 3] written
};

// Rows of numbers, to be added up by who owns them.
struct SumRequest {
  int64_t count, width;
  const int64_t *owners;  // [count]
  const double *values;   // [count, width]
  double *sums;           // [owners, width] added to
};

// What was said of the velocities of bodies, to be judged about a point of each; see `velocity_equations.py`.
struct JudgeRequest {
  int64_t count;
  const double *scale;                                // [6] m/s and rad/s that is expected, 1 sigma
  const double *H, *g, *squares, *points;             // [count, 6, 6], [count, 6], [count], [count, 3] m
  double *evidence, *at_rest, *fit, *costs, *told;    // [count] written
};

// The same, to be solved.
struct VelocityRequest {
  int64_t count;
  const double *scale, *H, *g, *points;
  double *velocities;  // [count, 6] written
};

// The same, to be told with the velocities of other points as unknowns.
struct MoveRequest {
  int64_t count;
  const double *H, *g, *points;
  double *moved_H, *moved_g;  // [count, 6, 6], [count, 6] written
};

// What was said of the cells of one node, to be seen as two bodies; see `parts.py`.
struct HalvesRequest {
  int64_t count;
  const double *H, *g, *squares, *counts, *centres;  // [count, 6, 6], [count, 6], [count], [count], [count, 3] m
  const double *expected, *loose;                    // [6] m/s and rad/s, 1 sigma: to judge by, to solve by
  const uint8_t *suspected;                          // [count] or null
  double misfit;                                     // variance of the errors
  double least;                                      // independent observations of a part
  double rarely, better;                             // nats
  double mixed;                                      // share of neighbours that may be the other part's
  int32_t rounds, beside;                            // times that cells are dealt out again, neighbours
  uint8_t *second;                                   // [count] written: those of the smaller body
  uint8_t *found;                                    // [1] written: whether there are two
};

// Births [count] to be stored in `room` rows, those that nodes carry first, then those in free space, before what stands
// for a while, and for good; each in the order given.
struct NewbornRequest {
  int64_t count, nodes, room, first_id, stamp;
  float logit, growth;          // of the opacity; log of how many times its size a Gaussian may reach
  uint8_t standing, transient;  // tiers
  const double *means;          // [count, 3] m at the time of the view
  const float *log_radii, *rgb;               // [count], [count, 3]
  const uint8_t *on_background, *lasting;     // [count]
  const int64_t *views, *carriers, *founders;  // [count] nodes, -1 for none, and ids
  const double *positions, *quats;            // [views, nodes, 3], [views, nodes, 4]
  const uint8_t *node_tiers;                  // [nodes]
  const int64_t *rows;                        // [room] of the store, whose columns follow
  float *values, *moment1, *moment2;          // [capacity, 14]
  int64_t *steps;
  uint8_t *tiers;
  int64_t *ids, *carried_by, *founded_by, *rested, *births;
  float *largest;
  int64_t *doubts;
  uint8_t *homeless;
};

// Places, and things of which the nearest is wanted.
struct NearestRequest {
  int64_t places, owns, width;
  const double *at, *own;  // [places, width], [width, owns] in units of the distance that is too far
  int64_t *found;          // [places] rows of `own`, -1 for none
};

// Places that are dealt out to groups: the first that is in none, and all others in none that are near it, time and again.
struct GroupRequest {
  int64_t places, width;
  const double *at;    // [places, width] in units of the distance that is too far
  int64_t *groups;     // [places] written: numbers of the groups, in order
};

// Points [count, 3] seen by one camera.
struct PixelsRequest {
  int64_t count;
  int32_t width, height;
  const double *points;
  const double *viewmat, *K;  // [4, 4], [3, 3]
  int64_t *columns, *rows;    // [count]
  double *depths;             // [count]
  uint8_t *inside;            // [count]
  const float *radii;         // [count] of spheres about the points, or null
  float *reached;             // [count] pixels that these reach into the image from the pixel, or negative; with `radii`
};

// One view's part of the normal equations of moving nodes.
struct MotionRequest {
  int64_t count;
  int32_t width, height;
  double scale;         // weight of an observation
  double shown_share;   // of its depth that a Gaussian may differ by from what is shown where it shows
  double depth_share;   // of the depth that counts as much as a pixel
  double huber_px, colour_sigma;
  const double *means, *arms, *opacities;  // [count, 3] m, [count, 3] m from their nodes, [count]
  const int64_t *carriers;                 // [count] nodes
  const double *viewmat, *K;
  const uint8_t *counted;  // [H, W]
  const float *shown;      // [H, W, 4] rendered colour and depth
  const float *image;      // [H, W, 3]
  const float *flow;       // [H, W, 2] pixels
  const float *depth;      // [H, W] m or null
  double *H, *g;           // [nodes, 12, 12], [nodes, 12], added to
  double *squares, *weights;  // [nodes] weighted squared errors, and weights without opacities; added to
};

// Normal equations of nodes, to be solved in their first `size` parameters: 6, a rigid motion, or 12, a strain besides.
struct SolveRequest {
  int64_t count, size;
  const double *sigmas;                      // [size] that are expected, 1 sigma
  const double *H, *g, *squares, *weights;   // as `MotionRequest` has added them up
  double *solution, *variances, *cost;       // [count, size], [count, size], [count] written
};

}  // namespace model
