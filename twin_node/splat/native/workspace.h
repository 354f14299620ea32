// Memory that only grows: what one call left behind serves the next.
#pragma once

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <new>
#include <vector>

namespace splat {

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

// A thread's own part of a parallel loop, [first, end) in one word: its owner takes from the front, others from behind.
class alignas(64) Share {
 public:
  void set(int64_t first, int64_t end) { range_.store(pack(first, end), std::memory_order_relaxed); }

  // The next task, or -1 where none is left.
  int64_t take(bool own) {
    uint64_t range = range_.load(std::memory_order_relaxed);
    for (;;) {
      const int64_t first = static_cast<int64_t>(range >> 32), end = static_cast<int64_t>(range & 0xffffffffu);
      if (first >= end) return -1;
      const uint64_t rest = own ? pack(first + 1, end) : pack(first, end - 1);
      if (range_.compare_exchange_weak(range, rest, std::memory_order_relaxed)) return own ? first : end - 1;
    }
  }

 private:
  static uint64_t pack(int64_t first, int64_t end) {
    return static_cast<uint64_t>(first) << 32 | static_cast<uint64_t>(end);
  }
  std::atomic<uint64_t> range_{0};
};

// Runs task(0) ... task(count - 1), fewer than 2^32, on up to `threads` threads of the process's OpenMP runtime, which
// torch shares. Loops over the same things in the same order give a thread the same part of them every time: what
// another core wrote last is dear to read. Whoever is done helps the others.
template <class Task>
inline void parallel_for(int threads, int64_t count, const Task &task) {
  constexpr int kMostShares = 64;
  const int shares = static_cast<int>(std::min<int64_t>({threads, count, kMostShares}));
  if (shares <= 1) {
    for (int64_t i = 0; i < count; i++) task(i);
    return;
  }
  Share share[kMostShares];
  for (int i = 0; i < shares; i++) share[i].set(count * i / shares, count * (i + 1) / shares);
#pragma omp parallel num_threads(shares)
  {
    const int own = omp_get_thread_num();
    for (int k = 0; k < shares; k++) {
      for (int64_t i; (i = share[(own + k) % shares].take(k == 0)) >= 0;) task(i);
    }
  }
}

}  // namespace splat
