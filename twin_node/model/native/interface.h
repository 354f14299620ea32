// What crosses the boundary of the library: plain structs, mirrored in `model/kernel_requests.py` and `node_requests.py`.
#pragma once

#include <cstdint>

#include "node_requests.h"

namespace model {

constexpr int32_t kInterfaceVersion = 29;

constexpr int kRowsPerTask = 32;  // of an image whose pixels are independent

// What counts as change; see `camera_mask.py`. Levels are those of 8-bit images.
struct MaskRules {
  double change_sigmas, change_levels, settle_ns, smallest_area, shadow_darkest, reflection_brightest;
  double ground_certainty, ground_likelihood, ground_around, learning_rate, depth_levels, noise_sigmas, most_noise;
  double telling, lost_ns;
  int32_t rings;    // of uncovered ground that are found per image
  int32_t closing;  // radius of the kernel that closes gaps, pixels
  const uint8_t *kernel;  // [2 closing + 1, 2 closing + 1]
};

// One camera's next image, and all that is remembered of the ones before; that is brought up to date in place.
struct MaskRequest {
  int32_t width, height;
  int32_t is_silent;            // whether no depth has come for long
  float elapsed_ns;             // since the image before
  const MaskRules *rules;
  const uint8_t *smooth;        // [H, W, 3] the image, slightly smoothed
  const uint8_t *seen;          // [H, W] valid, and off the robot
  const float *reference, *last;  // [3, H, W] the image of one baseline ago, and the one before
  const float *measured;        // [H, W] m, 0 where unknown, or null
  float *image;                 // [3, H, W] written: `smooth` as planes
  float *background, *depth;    // [3, H, W], [H, W] m and 0 where unknown
  float *measured_last;         // [H, W] m, 0 where unknown: by the newest image that measured it
  float *telling;               // [H, W] share of the images of free ground that measured it
  float *blind_ns;              // [H, W] since it was measured
  float *still_ns;              // [H, W]
  uint8_t *known, *trusted, *confirmed, *mask;  // [H, W]
  double *ground, *moving;      // [4096] how often each colour was free ground, and a moving thing
  double *sigma;                // [1] noise of the images, levels; 0 until there are two
  double *bared;                // [1] pixels of late that something moved off which had been there from the start
  double *depth_noise;          // [1] 1 sigma at 1 m, m; 0 until it has been measured
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

// What one camera sees where nothing moves, which is brought up to date in place, beside what stands behind it.
struct StillRequest {
  int64_t pixels;
  int32_t threads;
  float threshold, uptake, since_s, calm_s;
  const float *image, *background;      // [H, W, 3] 0 to 1
  const uint8_t *usable, *near_moving;  // [H, W]
  const float *measured;                // [H, W] m, 0 where nothing is, or null
  float *rgb, *depth, *calm_for_s;      // [H, W, 3], [H, W] m, s: brought up to date
  uint8_t *hidden, *stirred, *counted;  // [H, W] written
  float *difference;                    // [H, W] written, 0 to 1
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
  int32_t width, height;
  const uint8_t *image;                  // [H, W, 3]
  const float *background;               // [H, W, 3]
  const uint8_t *usable, *near_moving;   // [H, W]
  const float *depth;                    // [H, W] m, 0 where it is not measured, or null
  const float *known, *before_s;         // [H, W] `misfit` and `wrong_s` of the set before, or null
  float *rgb, *surprise;                 // [H, W, 3], [H, W] written, as the next ones
  float *misfit, *wrong_s;               // [H, W]
  uint8_t *stale, *active;               // [H, W]
  float *nearest;                        // [H, W] m, or null as `depth`
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

// Points before an arm's capsules.
struct CapsuleRequest {
  int64_t points, capsules;
  double shortest_square;  // m^2 of an axis that is divided by
  const double *ends;      // [capsules, 2, 3] m
  const double *radii;     // [capsules] m
  const double *at;        // [3, points] m
  double *gaps;            // [points] written, m: to the nearest surface, negative inside
  int64_t *nearest;        // [points] written: whose that is, of equally near ones the first
  double *shares;          // [points] written, 0 to 1: where on its axis the nearest place is
};

// What one view shows within the outline of an arm.
struct OutlineView {
  int32_t width, height;
  const double *K;         // [3, 3]
  const double *ends;      // [capsules, 2, 3] m, in the optical frame
  const double *radii;     // [capsules] m
  const uint8_t *outline;  // [H, W]
  const float *depth;      // [H, W] m, 0 where it is not measured
  uint8_t *before, *past;  // [H, W] written: in front of the arm; past it, or beyond the outline
};

struct OutlineRequest {
  int64_t capsules;
  double shortest_square;       // m^2, as above
  double clear_m, depth_share;  // what is farther than both together, m and of the depth, is off the arm
  int32_t count, threads;
  const OutlineView *views;  // [count]
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
  double threshold, solid, colour_sigma, same_depth, huge, refuted;
  double locality, neighbour_px, fewest, dissent, occlusion, spread;
  double alike;   // largest difference of a channel within a block that is larger than the smallest
  int64_t quota;  // births per view
  int32_t samples;
  int32_t side;  // of the largest block of pixels that one newborn stands for
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
  int32_t width;  // levels twice as wide or more are not searched
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
  double occlusion, seen_through, reach, threshold;
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
  const float *means;                  // [view_count, count, 3] m
  const double *radii;                 // [count] m, alike in all views
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
