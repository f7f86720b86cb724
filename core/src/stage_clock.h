// How long the stages of one solve take.
#pragma once

#include <ctime>
#include <utility>
#include <vector>

#include "covinz/solve_loop.h"

namespace covinz {

class StageClock {
 public:
  // Ends the stage that runs, if any.
  void Start(const char* name) {
    End();
    times_.push_back({name, 0.0});
    begin_ms_ = Now_ms();
  }

  // Of the stages so far, in order.
  std::vector<StageTime> Times() {
    End();
    return std::move(times_);
  }

 private:
  void End() {
    if (!times_.empty()) times_.back().ms = Now_ms() - begin_ms_;
  }

  static double Now_ms() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
  }

  double begin_ms_ = 0.0;
  std::vector<StageTime> times_;
};

}  // namespace covinz
