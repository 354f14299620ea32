// Memory that only grows: what one call left behind serves the next.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <new>
#include <vector>

#include "../../native/crew.h"

namespace splat {

using crew::parallel_for;

// Uninitialised memory, aligned to a cache line, that grows by doubling and never shrinks.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  Buffer(Buffer &&other) noexcept : data_(other.data_), capacity_(other.capacity_) {
    other.data_ = nullptr;
    other.capacity_ = 0;
  }
  Buffer(const Buffer &) = delete;
  Buffer &operator=(const Buffer &) = delete;
  ~Buffer() { std::free(data_); }

  // Room for `count` elements and one vector more; what was inside is lost if it has to grow.
  T *reserve(size_t count) {
    if (count > capacity_ || data_ == nullptr) {
      const size_t wanted = count > 2 * capacity_ ? count : 2 * capacity_;
      const size_t bytes = ((wanted * sizeof(T) + kSlackBytes) / kLine + 1) * kLine;
      std::free(data_);
      capacity_ = 0;
      data_ = static_cast<T *>(std::aligned_alloc(kLine, bytes));
      if (data_ == nullptr) throw std::bad_alloc();
      capacity_ = wanted;
    }
    return data_;
  }
  T *data() { return data_; }
  const T *data() const { return data_; }
  T &operator[](size_t i) { return data_[i]; }
  const T &operator[](size_t i) const { return data_[i]; }

 private:
  static constexpr size_t kLine = 64, kSlackBytes = 64;
  T *data_ = nullptr;
  size_t capacity_ = 0;
};

// Keeps workspaces that are not in use, so that concurrent calls each find their own.
template <class Workspace>
class Pool {
 public:
  Pool() { idle_.reserve(kKept); }  // giving back takes no memory
  Workspace *acquire() {
    std::lock_guard<std::mutex> lock(mutex_);
    if (idle_.empty()) return new Workspace();
    Workspace *workspace = idle_.back();
    idle_.pop_back();
    return workspace;
  }
  void release(Workspace *workspace) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      if (idle_.size() < kKept) {
        idle_.push_back(workspace);
        return;
      }
    }
    delete workspace;
  }

 private:
  static constexpr size_t kKept = 4;  // more than a tracker and a mapper hold at once
  std::mutex mutex_;
  std::vector<Workspace *> idle_;
};

// All threads or one: a stage that takes less than some 50 us is not worth waking others for, and on a busy machine the
// wait for a thread that is not scheduled costs milliseconds. `grain` is the work that takes about so long.
inline int threads_for(int threads, int64_t work, int64_t grain) { return work < grain ? 1 : threads; }

}  // namespace splat
