// What crosses the boundary of the library: plain structs, mirrored in `model/kernel_requests.py`.
#pragma once

#include <cstdint>

namespace model {

constexpr int32_t kInterfaceVersion = 18;

enum Status : int32_t { kOk = 0, kOutOfMemory = 1 };

// What counts as change; see `MovingMaskParameters`. Levels are those of 8-bit images.
struct MaskRules {
  double change_sigmas, change_levels, settle_ns, smallest_area, shadow_darkest, reflection_brightest;
  double ground_certainty, ground_likelihood, learning_rate, depth_levels;
  int32_t rings;    // of uncovered ground that are found per image
  int32_t closing;  // radius of the kernel that closes gaps, pixels
  const uint8_t *kernel;  // [2 closing + 1, 2 closing + 1]
};

// One camera's next image, and all that is remembered of the ones before; that is brought up to date in place.
struct MaskRequest {
  int32_t width, height;
  float elapsed_ns;             // since the image before
  const MaskRules *rules;
  const uint8_t *smooth;        // [H, W, 3] the image, slightly smoothed
  const uint8_t *seen;          // [H, W] valid, and off the robot
  const float *reference, *last;  // [3, H, W] the image of one baseline ago, and the one before
  const float *measured;        // [H, W] m, 0 where unknown, or null
  float *image;                 // [3, H, W] written: `smooth` as planes
  float *background, *depth, *still_ns;  // [3, H, W], [H, W] or null, [H, W]
  uint8_t *known, *trusted, *confirmed, *mask;  // [H, W]
  double *ground, *moving;      // [4096] how often each colour was free ground, and a moving thing
  double *sigma;                // [1] noise of the images, levels
};

struct MaskRequests {
  int32_t count, threads;
  const MaskRequest *cameras;  // [count]
};

// An image of which every few pixels, each way, are looked at; h rows of w.
struct SampledImage {
  int32_t width, height, stride;
  const uint8_t *rgb, *still;  // [H, W, 3], [H, W] what stands still
};

// How bright an image shows what a camera saw at rest; see `exposure.py`.
struct RatioRequest {
  SampledImage image;
  float darkest, brightest;            // colours that tell a ratio, 0 to 1
  const float *rest;                   // [h, w, 3] what the camera saw at rest, 0 to 1
  const float *gains, *offsets;        // [3] the exposure that it is looked at with
  int64_t *found;                      // [2] written: pixels at rest, and those of them that tell
  float *middle;                       // [3] written where there are any
};

// The memory of what a camera sees at rest, which is brought up to date in place.
struct RestRequest {
  SampledImage image;
  float slack, uptake;
  uint8_t *newest;  // [H, W, 3]
  float *rest;      // [h, w, 3]
};

// Images of Gaussians, drawn on nothing, that are put before what stands behind them.
struct BackdropRequest {
  int64_t pixels;
  const float *alphas, *backdrop;  // [pixels], [pixels, 4]
  float *renders;                  // [pixels, 4]
};

// What counts as other than the background; see `observation.py`.
struct ObserveRules {
  float threshold, growth, elapsed_s, stale_s;
  int32_t is_first;  // whether no image has been seen before
};

// One view, and what is remembered of its pixels.
struct ObservedView {
  int64_t pixels;
  const uint8_t *image;                  // [H, W, 3]
  const float *background;               // [H, W, 3]
  const uint8_t *usable, *near_moving;   // [H, W]
  const float *known, *before_s;         // [H, W] `misfit` and `wrong_s` of the set before, or null
  float *rgb, *surprise;                 // [H, W, 3], [H, W] written, as the next ones
  float *misfit, *wrong_s;               // [H, W]
  uint8_t *stale, *active;               // [H, W]
};

struct ObserveRequest {
  int32_t count, threads;
  const ObserveRules *rules;
  const ObservedView *views;  // [count]
};

// One view of points that move, and the pixels that a rendering of them is held to.
struct HeldView {
  int32_t width, height;
  const double *viewmat, *K;       // [4, 4], [3, 3]
  const float *means;              // [points, 3] m
  const uint8_t *active, *usable;  // [H, W]
  uint8_t *held;                   // [H, W] written
};

struct HeldRequest {
  int64_t points;
  int32_t skirt, around;  // pixels around what is active, and around points
  int32_t count, threads;
  const HeldView *views;  // [count]
};

// One view of points that move, and of the STATIC Gaussians.
struct OccluderView {
  int32_t width, height;
  const double *viewmat, *K;  // [4, 4], [3, 3]
  const float *means;         // [points, 3] m
  const double *depths;       // [standing] m
  const int64_t *cells;       // [standing] which of the image's cells each falls in, counted row by row
  const float *reach_px;      // [standing] negative: does not reach into the image
};

struct OccluderRequest {
  int64_t standing, points;
  int32_t cell_px, view_count;
  const OccluderView *views;  // [view_count]
  uint8_t *before;            // [standing] written: can stand before a point in some view
};

// What counts as unexplained, and what speaks for a depth; see `births.py`.
struct BirthRules {
  double threshold, solid, colour_sigma, same_depth, huge_px, refuted;
  double locality, neighbour_px, fewest, dissent, occlusion, spread;
  int64_t quota;  // births per view
  int32_t samples;
};

// One view, and the births that it needs.
struct BirthView {
  int32_t width, height;
  const double *viewmat, *K, *T_base_cam;  // [4, 4], [3, 3], [4, 4]
  const float *rgb, *shown;                // [H, W, 3] the image, [H, W, 4] rendered colour and depth
  const double *far, *rays;                // [H, W] m and [H, W, 3]: the background's depth, and the pixels' rays
  const float *alpha, *surprise;           // [H, W] of the background, and what differs from it
  const uint8_t *active, *usable, *near_moving, *stale;  // [H, W]
  const float *measured;                                 // [H, W] m, or null
  double *means, *radii;                                 // [quota, 3], [quota] written, as the next three
  float *colours;                                        // [quota, 3]
  uint8_t *on_background, *lasting;                      // [quota]
  int64_t *born;                                         // [1] how many have been written
};

struct BirthRequest {
  int32_t count, threads;
  const BirthRules *rules;
  const BirthView *views;  // [count]
};

// How optical flow is sought; see `patch_flow.py`.
struct FlowRules {
  int32_t stride, levels, passes, steps, border;
  float stiffness;
};

// One view whose flow is sought, from what is shown to what came.
struct FlowView {
  int32_t width, height;
  const float *shown;    // [H, W, 4] rendered colour, 0 to 1, and depth
  const uint8_t *image;  // [H, W, 3]
  const uint8_t *wanted;  // [H, W] where it is sought
  float *flow;           // [H, W, 2] pixels, written; 0 where it is not sought
};

struct FlowRequest {
  int32_t count, threads;
  const FlowRules *rules;
  const FlowView *views;  // [count]
};

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

// Gaussians that were drawn, what views miss of them, and the store that they come from; see `least_squares.py`.
struct DampedRequest {
  int64_t count;
  int32_t standing;  // the tier of those that may take the step
  float shape_share, colour_share, fewest, longest, smallest_log_scale;
  const int64_t *rows;                  // [count] of the store
  const uint8_t *learners;              // [count]
  const int64_t *drawn_ids;             // [count] ids that the rows had then
  const float *scales, *opacities;      // [count, 3] m, [count]
  const float *means, *quats, *sizes;   // [count, 3], [count, 4], [count, 3] which way each should go, as the next two
  const float *logits, *colours;        // [count] by the opacity, [count, 4] and blend weights over all pixels
  const uint8_t *alive, *tiers;         // [capacity]
  const int64_t *ids;                   // [capacity]
  const float *ceilings;                // [capacity] largest log scale
  float *values;                        // [capacity, 14] brought up to date in place
  int64_t *refused;                     // [1] written: steps that would not have been finite, and were not taken
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

// Points along the rays of one view's pixels, to be found in another view; see `matching.py`.
struct CompareRequest {
  int64_t pixels, labels;
  int32_t width, height, threads;         // the first two of the other view
  const double *centre, *reach, *shares;  // [3] m, [pixels, 3] m, [labels] of the reach
  const double *viewmat, *K;              // [4, 4], [3, 3] of the other view
  const float *rgb, *other;               // [pixels, 3], [H, W, 3] 0 to 1
  const uint8_t *valid;                   // [H, W] of the other view
  float *apart;                           // [pixels, labels] written: by how much colours differ, mean over channels
  int32_t *at;                            // [pixels, labels] written: the other's pixel; -1 where it does not see it
};

// Costs of labels in order, to be made alike among neighbours; see `semi_global.py`.
struct SmoothRequest {
  int64_t height, width, labels;
  int32_t threads;
  float step_cost, jump_cost, edge;
  const float *costs, *image;  // [H, W, K], [H, W, 3] 0 to 1
  float *pairs;                // [4, H, W, K] written: of each pair of opposite paths
  float *smoothed;             // [H, W, K] written
};

// What refutes a Gaussian; see `deaths.py`.
struct DeathRules {
  double occlusion, seen_through, reach, nearest_m, threshold;
};

// One view of what is there, and of the STATIC Gaussians.
struct DeathView {
  int32_t width, height;
  const double *viewmat, *K;                              // [4, 4], [3, 3]
  const double *far, *surface;                            // [H, W] m: the background's depth, the plane's or the shell's
  const uint8_t *usable, *active, *near_moving, *moving;  // [H, W]
  const float *surprise;                                  // [H, W]
  const float *nearest;                                   // [H, W] m, or null
  const float *shown;                                     // [H, W, 4] rendered colour and depth, or null
  const int64_t *columns, *rows;                          // [count] of `StaticRequest`, as the next two
  const double *depths;                                   // m
  const uint8_t *inside;
};

// Moving Gaussians at each view's time.
struct RefutedRequest {
  int64_t count;
  int32_t view_count, threads;
  const DeathRules *rules;
  const DeathView *views;              // [view_count]
  const float *means;          // [view_count, count, 3] m
  const float *quats, *scales; // [count, 4] w, x, y, z and [count, 3] m, alike in all views
  const uint8_t *carried;              // [count]
  uint8_t *refuted;                    // [count] written
};

struct StaticRequest {
  int64_t count;
  int32_t view_count, threads;
  const DeathRules *rules;
  const DeathView *views;  // [view_count]
  uint8_t *left, *moving;  // [count] written
};

}  // namespace model
