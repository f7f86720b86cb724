#include "covinz/instruction_set.h"

#include <initializer_list>

namespace covinz {

bool IsSupported(InstructionSet instruction_set) {
  switch (instruction_set) {
    case InstructionSet::kPortable:
      return true;
#if defined(__aarch64__)
    case InstructionSet::kNeon:
      return true;
#elif defined(__x86_64__)
    case InstructionSet::kSse42:
      return __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    case InstructionSet::kAvx2:
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("popcnt");
    case InstructionSet::kAvx512:
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512vpopcntdq") && __builtin_cpu_supports("avx512vnni");
#endif
    default:
      return false;
  }
}

InstructionSet BestInstructionSet() {
  for (const InstructionSet best : {InstructionSet::kAvx512, InstructionSet::kAvx2,
                                    InstructionSet::kSse42, InstructionSet::kNeon}) {
    if (IsSupported(best)) return best;
  }
  return InstructionSet::kPortable;
}

}  // namespace covinz
