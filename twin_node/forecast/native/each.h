// Parallel loops whose tasks may run out of memory.
#pragma once

#include <atomic>
#include <cstdint>
#include <new>

#include "../../native/crew.h"

namespace forecast {

// Runs work(i) for each; throws where any has no memory.
template <class Work>
inline void for_each_in_parallel(int threads, int64_t count, const Work &work) {
  std::atomic<bool> short_of_memory{false};
  crew::parallel_for(threads, count, [&](int64_t i) {
    try {
      work(i);
    } catch (const std::bad_alloc &) {
      short_of_memory = true;
    }
  });
  if (short_of_memory) throw std::bad_alloc();
}

}  // namespace forecast
