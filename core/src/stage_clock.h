// How long the stages of one solve take.
#pragma once

#include <chrono>
#include <utility>
#include <vector>

#include "covinz/solve_loop.h"

namespace covinz {

class StageClock {
 public:
  // Ends the stage that runs, if any.
  void Start(const char* name) {
    End();
    begin_ = std::chrono::steady_clock::now();
    times_.push_back({name, 0.0});
  }

  // Of the stages so far, in order.
  std::vector<StageTime> Times() {
    End();
    return std::move(times_);
  }

 private:
  void End() {
    if (times_.empty()) return;
    const std::chrono::duration<double, std::milli> time =
        std::chrono::steady_clock::now() - begin_;
    times_.back().ms = time.count();
  }

  std::chrono::steady_clock::time_point begin_;
  std::vector<StageTime> times_;
};

}  // namespace covinz
