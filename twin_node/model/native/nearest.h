// What of few things is nearest to each of few others: no tree pays for itself.
#pragma once

#include "interface.h"

namespace model {

// The row of `own` nearest to each place and nearer than 1; -1 without one. Of equally near ones the first.
inline void nearest(const NearestRequest &r) {
  for (int64_t i = 0; i < r.places; i++) {
    const double *place = r.at + i * r.width;
    double least = 1;
    r.found[i] = -1;
    for (int64_t j = 0; j < r.owns; j++) {
      const double *own = r.own + j * r.width;
      double apart = 0;
      for (int64_t k = 0; k < r.width && apart < least; k++) apart += (place[k] - own[k]) * (place[k] - own[k]);
      if (apart >= least) continue;
      least = apart;
      r.found[i] = j;
    }
  }
}

}  // namespace model
