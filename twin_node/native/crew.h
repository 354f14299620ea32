// Threads that help with parallel loops if they come in time, and that nobody waits for if they do not.
//
// OpenMP's loops end when all of their threads have come and gone, with or without work. On a machine that others use
// too, one that is not scheduled holds up a loop of 50 us for milliseconds. Here the caller does all that is left, and
// waits only for what another has begun.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <limits>
#include <mutex>
#include <new>
#include <thread>

namespace crew {

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

inline void relax() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

// Helpers that sleep between loops; one loop at a time has them.
class Crew {
 public:
  // Work on one's part of a loop, the caller's being 0; must not throw.
  struct Job {
    void (*work)(const void *context, int part);
    const void *context;
  };

  // Runs `job` as part 0 here and as parts 1 ... parts - 1 by whom of the helpers comes in time; returns when no helper
  // works on it any more. False, and nothing done, where another loop has the crew or it has kept loops waiting of late.
  bool run(const Job &job, int parts) {
    std::unique_lock<std::mutex> owner(owner_, std::try_to_lock);
    if (!owner.owns_lock() || is_dismissed()) return false;
    hire(parts - 1);
    job_ = job;
    parts_ = parts;
    state_.fetch_add(kOpen);
    if (asleep_.load() > 0) {
      { std::lock_guard<std::mutex> lock(door_); }
      wake_.notify_all();
    }
    const auto begun = Clock::now();
    job.work(job.context, 0);
    state_.fetch_sub(kOpen);
    const auto done = Clock::now();
    settle();
    judge(done - begun, Clock::now() - done);
    loops_.fetch_add(1, std::memory_order_relaxed);
    return true;
  }

 private:
  static constexpr uint32_t kOpen = 1u << 16, kInside = kOpen - 1;
  static constexpr int kSpins = 1000;

  using Clock = std::chrono::steady_clock;
  static constexpr int kMostAlone = 512;
  static constexpr std::chrono::microseconds kSlack{50};

  // Whether this loop is one of those that are done without helpers.
  bool is_dismissed() {
    if (alone_ == 0) return false;
    alone_--;
    return true;
  }

  // Who waits longer than it has worked had helpers that were not scheduled. The next loops are done without, more each
  // time that this is found again.
  void judge(Clock::duration worked, Clock::duration waited) {
    doubt_ = waited > worked + kSlack ? std::min(2 * doubt_ + 8, kMostAlone) : doubt_ / 2;
    alone_ = waited > worked + kSlack ? doubt_ : 0;
  }

  // No more where the system has no more threads or memory to give: who is there does it all.
  void hire(int wanted) {
    try {
      for (; hired_ < std::min(wanted, most_hired_); hired_++) {
        std::thread([this, part = hired_ + 1] { serve(part); }).detach();
      }
    } catch (const std::exception &) {
      most_hired_ = hired_;
    }
  }

  void serve(int part) {
    uint32_t seen = 0;
    for (;;) {
      await(seen);
      uint32_t state = state_.load();
      while ((state & kOpen) != 0 && !state_.compare_exchange_weak(state, state + 1, std::memory_order_acquire)) {
      }
      if ((state & kOpen) == 0) continue;
      seen = loops_.load(std::memory_order_relaxed) + 1;
      if (part < parts_) job_.work(job_.context, part);
      if ((state_.fetch_sub(1) & kInside) == 1 && is_waiting_.load()) {
        { std::lock_guard<std::mutex> lock(door_); }
        left_.notify_one();
      }
    }
  }

  // Until no helper is inside. Asleep after a while: a core that its caller keeps busy draws no helper that waits for one.
  void settle() {
    const auto is_empty = [this] { return (state_.load() & kInside) == 0; };
    for (int spins = 0; spins < kSpins; spins++) {
      if (is_empty()) return;
      relax();
    }
    std::unique_lock<std::mutex> lock(door_);
    is_waiting_.store(true);
    left_.wait(lock, is_empty);
    is_waiting_.store(false);
  }

  // Until a loop begins that is not one that has been `seen`.
  void await(uint32_t seen) {
    const auto is_due = [&] {
      return (state_.load() & kOpen) != 0 && loops_.load(std::memory_order_relaxed) + 1 != seen;
    };
    for (int spins = 0; spins < kSpins; spins++) {
      if (is_due()) return;
      relax();
    }
    std::unique_lock<std::mutex> lock(door_);
    asleep_.fetch_add(1);
    wake_.wait(lock, is_due);
    asleep_.fetch_sub(1);
  }

  std::mutex owner_, door_;
  std::condition_variable wake_, left_;
  std::atomic<uint32_t> state_{0}, loops_{0};
  std::atomic<int> asleep_{0};
  std::atomic<bool> is_waiting_{false};
  int hired_ = 0, most_hired_ = std::numeric_limits<int>::max(), parts_ = 0, doubt_ = 0, alone_ = 0;
  Job job_{};
};

inline Crew &helpers() {
  static Crew *const one = new Crew;  // its threads never end
  return *one;
}

// Runs task(0) ... task(count - 1), fewer than 2^32, on up to `threads` threads. Loops over the same things in the same
// order give a thread the same part of them every time: what another core wrote last is dear to read. Whoever is done
// helps the others. Throws `std::bad_alloc` where a task does; some of the others are then left undone.
template <class Task>
inline void parallel_for(int threads, int64_t count, const Task &task) {
  constexpr int kMostShares = 64;
  const int shares = static_cast<int>(std::min<int64_t>({threads, count, kMostShares}));
  struct Loop {
    const Task &task;
    int shares;
    Share share[kMostShares];
    std::atomic<bool> is_short_of_memory{false};
    void work(int own) {
      try {
        for (int k = 0; k < shares; k++) {
          for (int64_t i; (i = share[(own + k) % shares].take(k == 0)) >= 0;) task(i);
        }
      } catch (const std::bad_alloc &) {  // thrown from a helper it would end the process
        is_short_of_memory.store(true, std::memory_order_relaxed);
      }
    }
  };
  if (shares > 1) {
    Loop loop{task, shares};
    for (int i = 0; i < shares; i++) loop.share[i].set(count * i / shares, count * (i + 1) / shares);
    const Crew::Job job{
        [](const void *context, int own) { static_cast<Loop *>(const_cast<void *>(context))->work(own); }, &loop};
    if (helpers().run(job, shares)) {
      if (loop.is_short_of_memory.load(std::memory_order_relaxed)) throw std::bad_alloc();
      return;
    }
  }
  for (int64_t i = 0; i < count; i++) task(i);
}

}  // namespace crew
