// The plain C interface. Nothing throws across it: functions return a Status.
#include "../../native/boundary.h"
#include "descent.h"
#include "miss.h"
#include "place.h"
#include "weigh.h"

using boundary::guarded;

namespace {

splat::Pool<splat::Workspace> &workspaces() {
  static splat::Pool<splat::Workspace> pool;
  return pool;
}

splat::Status check_cameras(const splat::Request &r) {
  for (int i = 0; i < splat::images_of(r); i++) {
    if (!(r.Ks[9 * i] > 0.f && r.Ks[9 * i + 4] > 0.f)) return splat::kBadFocalLength;
    if (!splat::invertible(r.viewmats + 16 * i)) return splat::kSingularView;
  }
  return splat::kOk;
}

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

int32_t splat_interface_version() { return splat::kInterfaceVersion; }

// A workspace keeps what the backward pass needs; null where memory is short. Give it back with splat_release.
void *splat_acquire() {
  try {
    return workspaces().acquire();
  } catch (const std::bad_alloc &) {
    return nullptr;
  }
}
void splat_release(void *workspace) { workspaces().release(static_cast<splat::Workspace *>(workspace)); }

int32_t splat_forward(void *workspace, const splat::Request *request) {
  const int bad = splat::non_finite_argument(*request);
  if (bad >= 0) return splat::kNonFinite + bad;
  const splat::Status cameras = check_cameras(*request);
  if (cameras != splat::kOk) return cameras;
  return guarded([&] { return splat::forward(*static_cast<splat::Workspace *>(workspace), *request); });
}

// For the request of the workspace's last splat_forward.
int32_t splat_backward(void *workspace, const splat::Request *request, const splat::Gradients *gradients) {
  return guarded([&] { return splat::backward(*static_cast<splat::Workspace *>(workspace), *request, *gradients); });
}

void splat_place(const splat::PlaceRequest *request) { splat::place(*request); }

int32_t splat_descend(void *workspace, const splat::DescentRequest *request) {
  splat::LossRequest given = request->loss;
  given.render = request->scene.backdrop;  // what is seen is not drawn yet
  const int bad = splat::non_finite_argument(given);
  if (bad >= 0) return splat::kNonFinite + bad;
  const splat::Status cameras = check_cameras(request->scene);
  if (cameras != splat::kOk) return cameras;
  return guarded([&] { return splat::descend(*static_cast<splat::Workspace *>(workspace), *request); });
}

int32_t splat_add_missed(void *workspace, const splat::MissRequest *request) {
  const int bad = splat::non_finite_argument(request->scene);
  if (bad >= 0) return splat::kNonFinite + bad;
  const splat::Status cameras = check_cameras(request->scene);
  if (cameras != splat::kOk) return cameras;
  return guarded([&] { return splat::add_missed(*static_cast<splat::Workspace *>(workspace), *request); });
}

// For one image and no channels; `weights` [gaussians] are written.
int32_t splat_weigh(void *workspace, const splat::Request *request, float *weights) {
  const int bad = splat::non_finite_argument(*request);
  if (bad >= 0) return splat::kNonFinite + bad;
  const splat::Status cameras = check_cameras(*request);
  if (cameras != splat::kOk) return cameras;
  return guarded([&] { return splat::weigh(*static_cast<splat::Workspace *>(workspace), *request, weights); });
}

int32_t splat_image_loss(const splat::LossRequest *request) {
  const int bad = splat::non_finite_argument(*request);
  if (bad >= 0) return splat::kNonFinite + bad;
  return guarded([&] { return splat::image_loss(*request); });
}
}
#pragma GCC visibility pop
