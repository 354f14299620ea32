// The plain C interface. Nothing throws across it: functions return a Status.
#include "../../native/boundary.h"
#include "ahead.h"
#include "backdrop.h"
#include "bits.h"
#include "carve.h"
#include "cover.h"
#include "grow.h"
#include "hide.h"
#include "lead.h"
#include "look.h"
#include "mark.h"
#include "nearest.h"
#include "outlook.h"
#include "own.h"
#include "parts.h"
#include "reach.h"
#include "reckon.h"
#include "regress.h"
#include "rest.h"
#include "seen.h"
#include "shown.h"
#include "solve.h"
#include "surface.h"
#include "things.h"

using boundary::guarded;
using crew::parallel_for;

#pragma GCC visibility push(default)
extern "C" {

int32_t forecast_interface_version() { return forecast::kInterfaceVersion; }

int32_t forecast_grow(const forecast::GrowRequest *request) {
  return guarded([&] { forecast::grow(forecast::balls_of(*request)); });
}

int32_t forecast_grow_ahead(const forecast::AheadRequest *request) {
  return guarded([&] { forecast::Ways(*request).grow(); });
}

int32_t forecast_pack(const forecast::PackRequest *request) { return forecast::pack(*request); }

int64_t forecast_tally(const forecast::TallyRequest *request) { return forecast::tally(*request); }

int32_t forecast_list(const forecast::ListRequest *request) {
  return guarded([&] { forecast::list(*request); });
}

void forecast_runs(const forecast::RunsRequest *request) { forecast::runs(*request); }

int32_t forecast_look(const forecast::LookRequest *request) {
  return guarded([&] { forecast::look(*request); });
}

void forecast_revise(const forecast::ReviseRequest *request) { forecast::revise(*request); }

void forecast_conceal(const forecast::ConcealRequest *request) { forecast::conceal(*request); }

int32_t forecast_carve(const forecast::CarveRequest *request) {
  return guarded([&] { forecast::carve(*request); });
}

int32_t forecast_cover(const forecast::CoverRequest *request) {
  return guarded([&] { forecast::cover(*request); });
}

int32_t forecast_hide(const forecast::HideRequest *request) {
  return guarded([&] { forecast::hide(*request); });
}

int32_t forecast_mark(const forecast::MarkRequest *request) {
  return guarded([&] { forecast::mark(*request); });
}

int32_t forecast_split(const forecast::SplitRequest *request) {
  return guarded([&] { forecast::split(*request); });
}

int32_t forecast_link(const forecast::LinkRequest *request) {
  return guarded([&] { forecast::link(*request); });
}

int32_t forecast_gather(const forecast::GatherRequest *request) {
  return guarded([&] { forecast::gather(*request); });
}

int32_t forecast_see(const forecast::Views<forecast::SeeRequest> *all) {
  return guarded([&] { parallel_for(all->threads, all->count, [&](int64_t i) { forecast::see(all->views[i]); }); });
}

int32_t forecast_show(const forecast::Views<forecast::ShowRequest> *all) {
  return guarded([&] { parallel_for(all->threads, all->count, [&](int64_t i) { forecast::show(all->views[i]); }); });
}

int32_t forecast_tell(const forecast::Views<forecast::TellRequest> *all) {
  return guarded([&] { parallel_for(all->threads, all->count, [&](int64_t i) { forecast::tell(all->views[i]); }); });
}

void forecast_solve(const forecast::SolveRequest *request) { forecast::solve(*request); }

void forecast_lead(const forecast::LeadRequest *request) { forecast::lead(*request); }

int32_t forecast_outlook(const forecast::OutlookRequest *request) {
  return guarded([&] { forecast::Outlook(*request).find(); });
}

void forecast_reckon(const forecast::ReckonRequest *request) { forecast::reckon(*request); }

void forecast_reach(const forecast::ReachRequest *request) { forecast::reach(*request); }

int32_t forecast_regress(const forecast::RegressRequest *request) {
  return guarded([&] { forecast::regress(*request); });
}

int64_t forecast_find_quantile(const forecast::QuantileRequest *request) {
  int64_t bin = -1;
  guarded([&] { bin = forecast::find_quantile(*request); });
  return bin;
}

void forecast_rest(const forecast::RestRequest *request) { forecast::rest(*request); }

int32_t forecast_nearest(const forecast::NearestRequest *request) {
  return guarded([&] { forecast::nearest(*request); });
}

int32_t forecast_surface(const forecast::SurfaceRequest *request) {
  return guarded([&] { forecast::find_surface(*request); });
}

void forecast_take(const forecast::TakeRequest *request) { forecast::take(*request); }
}
#pragma GCC visibility pop
