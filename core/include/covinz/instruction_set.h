// The instruction sets that kernels are written for, and which of them this processor has.
#pragma once

namespace covinz {

enum class InstructionSet {
  kPortable,  // what the library is built for: SSE2 on x86-64
  kNeon,      // 64-bit ARM
  kSse42,     // with POPCNT: x86-64 since 2008
  kAvx2,      // with POPCNT: x86-64 since 2013
  kAvx512     // with VPOPCNTDQ and VNNI: x86-64 since 2019
};

// Whether this processor and this build have it.
bool IsSupported(InstructionSet instruction_set);
InstructionSet BestInstructionSet();

}  // namespace covinz
