// Where parts may be in every layer: moved, widened, and held along their ways where they may turn back or swerve.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "grow.h"
#include "interface.h"
#include "rounded.h"

namespace forecast {

class Ways {
 public:
  // Rows of shifts and reaches: the parts, their rims, what may start, and then every step of those that turn, and of
  // those that swerve, whose rims do not.
  explicit Ways(const AheadRequest &request) : r_(request) {
    for (int64_t part = 0; part < r_.parts; part++) {
      if (turns(part)) turning_.push_back(part);
      if (r_.swerving[part]) swerving_.push_back(part);
    }
    steps_ = steps(2 * longest(turning_, nullptr)), aside_steps_ = steps(longest(swerving_, r_.swerved));
    rows_ = 2 * r_.parts + 1 + 2 * steps_ * static_cast<int64_t>(turning_.size()) +
            aside_steps_ * static_cast<int64_t>(swerving_.size());
    shifts_.resize(r_.layers * rows_ * 3), reaches_.resize(r_.layers * rows_);
    for (int64_t layer = 0; layer < r_.layers; layer++) place(layer);
  }

  void grow() const {
    Balls balls(r_.grid);
    balls.shifts = shifts_.data(), balls.reaches = reaches_.data();
    balls.groups = groups(), balls.cored = r_.parts;
    const auto place = [&](int64_t i, int axis) {
      return i < r_.voxels ? r_.places[axis * r_.voxels + i] : r_.rest[axis * r_.resting + i - r_.voxels];
    };
    const auto group = [&](int64_t i) {
      return i < r_.voxels ? r_.labels[i] + (r_.likely[i] ? 0 : r_.parts) : 2 * r_.parts;
    };
    const auto core = [&](int64_t i) { return i < r_.voxels && r_.likely[i]; };
    balls.list(r_.voxels + r_.resting, 2 * r_.parts + 1, place, group, core);
    forecast::grow(balls);
  }

 private:
  bool is_outside(const double *from, const double *moved) const {
    const int32_t dims[3] = {r_.grid.nx, r_.grid.ny, r_.grid.nz};
    for (int k = 0; k < 3; k++) {
      const double place = std::floor((from[k] + (moved ? moved[k] : 0.0) - r_.origin[k]) / r_.voxel_size);
      if (!(place >= 0 && place < dims[k])) return true;
    }
    return false;
  }

  // What leaves the grid may come back: where it is outside already, a wider bound blocks nothing.
  bool turns(int64_t part) const {
    if (r_.turning[part]) return true;
    const double *here = r_.centers + 3 * part;
    return is_outside(here, nullptr) && is_outside(here, displacement(r_.layers - 1, part));
  }

  const double *displacement(int64_t layer, int64_t part) const {
    return r_.displacements + 3 * (layer * r_.parts + part);
  }

  // Longest of the displacements at the last layer, or of what `to` is beside these.
  FORECAST_ROUNDED double longest(const std::vector<int64_t> &parts, const double *to) const {
    FORECAST_ROUNDED_BODY
    double found = 0;
    for (const int64_t part : parts) {
      const double *d = displacement(r_.layers - 1, part);
      double squares[3];
      for (int k = 0; k < 3; k++) {
        const double along = to ? to[3 * ((r_.layers - 1) * r_.parts + part) + k] - d[k] : d[k];
        squares[k] = along * along;
      }
      found = std::max(found, std::sqrt(squares[0] + squares[1] + squares[2]));
    }
    return found;
  }

  int64_t steps(double length) const {
    return std::min<int64_t>(static_cast<int64_t>(std::ceil(length / r_.part_size)), r_.most_steps);
  }

  // How far a rim goes beside its part, whose bound is given: nowhere while that is within the rounding to voxels.
  double rim(double radius) const {
    return radius > r_.rounding * r_.voxel_size ? std::min(radius, r_.rim_radius) : 0.0;
  }

  void place(int64_t layer) {
    int64_t row = layer * rows_;
    const double *radii = r_.radii + layer * r_.parts;
    for (int64_t part = 0; part < r_.parts; part++) set(row++, displacement(layer, part), 1, radii[part]);
    for (int64_t part = 0; part < r_.parts; part++) {
      set(row++, displacement(layer, part), 1, rim(radii[part]));
    }
    constexpr double kStill[3] = {};
    set(row++, kStill, 1, r_.started[layer]);
    for (int64_t step = 1; step <= steps_; step++) {
      const double share = 1 - 2.0 * static_cast<double>(step) / static_cast<double>(steps_);
      for (const int64_t part : turning_) set(row++, displacement(layer, part), share, r_.narrower * radii[part]);
      for (const int64_t part : turning_) {
        set(row++, displacement(layer, part), share, r_.narrower * rim(radii[part]));
      }
    }
    for (int64_t step = 1; step <= aside_steps_; step++) {
      const double share = static_cast<double>(step) / static_cast<double>(aside_steps_);
      for (const int64_t part : swerving_) set_aside(row++, layer, part, share, r_.narrower * radii[part]);
    }
  }

  FORECAST_ROUNDED void set_aside(int64_t row, int64_t layer, int64_t part, double share, double radius) {
    FORECAST_ROUNDED_BODY
    const double *led = displacement(layer, part), *swerved = r_.swerved + 3 * (layer * r_.parts + part);
    double between[3];
    for (int k = 0; k < 3; k++) {
      const double aside = share * (swerved[k] - led[k]);
      between[k] = led[k] + aside;
    }
    set(row, between, 1, radius);
  }

  FORECAST_ROUNDED void set(int64_t row, const double *displacement, double share, double radius) {
    FORECAST_ROUNDED_BODY
    const double farthest = r_.farthest;
    for (int k = 0; k < 3; k++) {
      const double voxels = std::nearbyint(share * displacement[k] / r_.voxel_size);
      shifts_[3 * row + k] = static_cast<int32_t>(std::min(std::max(voxels, -farthest), farthest));
    }
    const double voxels = radius / r_.voxel_size + (radius > 0 ? r_.rounding : 0.0);
    const double reach = kPerVoxel * voxels - 1e-6;
    const uint16_t *level = std::lower_bound(r_.level, r_.level + r_.levels - 1, reach);
    reaches_[row] = *level;
  }

  // Of whose points each row is: of the parts, of their rims, and of what may start.
  std::vector<int64_t> groups() const {
    std::vector<int64_t> found;
    found.reserve(rows_);
    for (int64_t group = 0; group <= 2 * r_.parts; group++) found.push_back(group);
    for (int64_t step = 0; step < steps_; step++) {
      found.insert(found.end(), turning_.begin(), turning_.end());
      for (const int64_t part : turning_) found.push_back(r_.parts + part);
    }
    for (int64_t step = 0; step < aside_steps_; step++) found.insert(found.end(), swerving_.begin(), swerving_.end());
    return found;
  }

  const AheadRequest &r_;
  std::vector<int64_t> turning_, swerving_;  // parts
  int64_t steps_ = 0, aside_steps_ = 0, rows_ = 0;
  std::vector<int32_t> shifts_;
  std::vector<uint16_t> reaches_;
};

}  // namespace forecast
