// Images of Gaussians before what stands behind them.
#pragma once

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace model {

inline void put_before(const BackdropRequest &r) {
  for (int64_t i = 0; i < r.pixels; i++) {
    const float through = 1.f - r.alphas[i];
    for (int64_t k = 4 * i; k < 4 * i + 4; k++) r.renders[k] += through * r.backdrop[k];
  }
}

}  // namespace model

#include "../../native/rounded_as_usual.h"
