// The plain C boundary of a room's library: nothing is thrown across it.
#pragma once

#include <cstdint>
#include <new>
#include <type_traits>

namespace boundary {

enum Status : int32_t { kOk = 0, kOutOfMemory = 1 };  // of every room, which may have more

// What work() says, `kOk` where it says nothing.
template <class Work>
int32_t guarded(const Work &work) {
  try {
    if constexpr (std::is_void_v<decltype(work())>) {
      work();
      return kOk;
    } else {
      return work();
    }
  } catch (const std::bad_alloc &) {
    return kOutOfMemory;
  }
}

}  // namespace boundary
