// The plain C interface. Nothing throws across it: functions return a Status.
#include "../../native/boundary.h"
#include "../../native/crew.h"
#include "backdrop.h"
#include "births.h"
#include "capsules.h"
#include "cells.h"
#include "damped.h"
#include "deaths.h"
#include "exposing.h"
#include "flow.h"
#include "halves.h"
#include "held.h"
#include "look.h"
#include "mask.h"
#include "matching.h"
#include "motion.h"
#include "nearest.h"
#include "newborns.h"
#include "observing.h"
#include "occluders.h"
#include "outline.h"
#include "poses.h"
#include "publishing.h"
#include "semi_global.h"
#include "still.h"
#include "velocities.h"

namespace {

// Runs task(0) ... task(count - 1) on up to `threads` threads.
template <class Task>
int32_t side_by_side(int threads, int64_t count, const Task &task) {
  return boundary::guarded([&] { crew::parallel_for(threads, count, task); });
}

// The same of bands of rows of `count` views, whose heights `views` tell: `task(view, first row)`.
template <class View, class Task>
int32_t band_by_band(int threads, int64_t count, const View *views, int rows, const Task &task) {
  int tallest = 0;
  for (int64_t i = 0; i < count; i++) tallest = std::max(tallest, views[i].height);
  const int64_t bands = (tallest + rows - 1) / rows;
  return side_by_side(threads, count * bands, [&](int64_t i) {
    const View &view = views[i / bands];
    const int first = static_cast<int>(i % bands) * rows;
    if (first < view.height) task(view, first);
  });
}

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

int32_t model_interface_version() { return model::kInterfaceVersion; }

int32_t model_mask(const model::MaskRequests *requests) {
  return side_by_side(requests->threads, requests->count,
                      [&](int64_t i) { model::MaskUpdate(requests->cameras[i]).run(); });
}

void model_advance(const model::AdvanceRequest *request) { model::advance(*request); }

void model_moved(const model::MovedRequest *request) { model::find_moved(*request); }

void model_carry(const model::CarryRequest *request) { model::carry(*request); }

void model_store_newborns(const model::NewbornRequest *request) { model::store_newborns(*request); }

void model_find_pixels(const model::PixelsRequest *request) { model::find_pixels(*request); }

void model_gather_motion(const model::MotionRequest *request) { model::gather_motion(*request); }

void model_solve_motions(const model::SolveRequest *request) { model::solve_motions(*request); }

void model_nearest(const model::NearestRequest *request) { model::nearest(*request); }

void model_publish(const model::PublishRequest *request) {
  const int64_t tasks = (request->count + model::kPublishedPerTask - 1) / model::kPublishedPerTask;
  crew::parallel_for(request->threads, tasks, [&](int64_t i) { model::publish(*request, i * model::kPublishedPerTask); });
}

void model_find_changes(const model::ChangeRequest *request) { model::find_changes(*request); }

void model_extents(const model::ExtentRequest *request) { model::find_extents(*request); }

int32_t model_creep(const model::CreepRequest *request) {
  return boundary::guarded([&] { model::find_creep(*request); });
}

int32_t model_cells(const model::CellRequest *request) {
  return boundary::guarded([&] { model::find_cells(*request); });
}

void model_judge_velocities(const model::JudgeRequest *request) { model::judge_velocities(*request); }

void model_solve_velocities(const model::VelocityRequest *request) { model::solve_velocities(*request); }

void model_move_velocities(const model::MoveRequest *request) { model::move_velocities(*request); }

int32_t model_halves(const model::HalvesRequest *request) {
  return boundary::guarded([&] { model::Halves(*request).find(); });
}

void model_capsules(const model::CapsuleRequest *request) { model::find_nearest_capsules(*request); }

int32_t model_outline(const model::OutlineRequest *r) {
  return band_by_band(r->threads, r->count, r->views, model::kRowsPerTask,
                      [&](const model::OutlineView &view, int first) { model::tell_outline(*r, view, first); });
}

void model_take_damped(const model::DampedRequest *request) { model::take_damped(*request); }

void model_group(const model::GroupRequest *request) { model::group(*request); }

void model_add_up(const model::SumRequest *request) { model::add_up(*request); }

int32_t model_observe(const model::ObserveRequest *r) {
  return band_by_band(r->threads, r->count, r->views, model::kRowsPerTask,
                      [&](const model::ObservedView &view, int first) { model::observe(*r->rules, view, first); });
}

int32_t model_ratios(const model::RatioRequest *request) {
  return boundary::guarded([&] { model::find_ratios(*request); });
}

void model_put_before(const model::BackdropRequest *request) { model::put_before(*request); }

void model_remember(const model::RestRequest *request) { model::remember(*request); }

int32_t model_still(const model::StillRequest *request) {
  const int64_t tasks = (request->pixels + model::kStillPerTask - 1) / model::kStillPerTask;
  return side_by_side(request->threads, tasks,
                      [&](int64_t i) { model::look_at_still(*request, i * model::kStillPerTask); });
}

int32_t model_occluders(const model::OccluderRequest *request) {
  return boundary::guarded([&] { model::find_occluders(*request); });
}

int32_t model_held(const model::HeldRequest *request) {
  return side_by_side(request->threads, request->count, [&](int64_t i) { model::hold(*request, request->views[i]); });
}

int32_t model_refute(const model::RefutedRequest *request) {
  return side_by_side(request->threads, model::tasks_of(request->count),
                      [&](int64_t i) { model::refute(*request, i); });
}

int32_t model_judge(const model::StaticRequest *request) {
  return side_by_side(request->threads, model::tasks_of(request->count),
                      [&](int64_t i) { model::judge(*request, i); });
}

int32_t model_compare(const model::CompareRequest *request) {
  return side_by_side(request->threads, request->pixels, [&](int64_t i) { model::compare(*request, i); });
}

int32_t model_smooth(const model::SmoothRequest *request) {
  const int32_t status = side_by_side(request->threads, model::kPathPairs, [&](int64_t i) {
    model::PathSums(*request, model::kPaths[i], request->pairs + i * model::entries(*request)).run();
  });
  if (status == boundary::kOk) model::add_pairs(*request);
  return status;
}

int32_t model_flow(const model::FlowRequest *request) {
  return side_by_side(request->threads, request->count,
                      [&](int64_t i) { model::find_flow(*request->rules, request->views[i]); });
}

int32_t model_births(const model::BirthRequest *request) {
  return side_by_side(request->threads, request->count,
                      [&](int64_t i) { model::ViewBirths(*request, static_cast<int>(i)).run(); });
}
}
#pragma GCC visibility pop
