// Binds descriptor matching: the reference by OpenCV and the one of rigs.
#include "covinz/matching.h"

#include <optional>

#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "bindings.h"
#include "covinz/rig_matching.h"

namespace covinz {
namespace {

namespace nb = nanobind;
using nb::literals::operator""_a;

using MatchRows = Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>;

MatchRows ToRows(const std::vector<Match>& matches) {
  MatchRows rows(static_cast<Eigen::Index>(matches.size()), 2);
  for (size_t i = 0; i < matches.size(); ++i) {
    rows.row(static_cast<Eigen::Index>(i)) << matches[i].query, matches[i].cand;
  }
  return rows;
}

void BindInstructionSet(nb::module_& m) {
  nb::enum_<InstructionSet>(m, "InstructionSet", "What the kernels of the core may use.")
      .value("PORTABLE", InstructionSet::kPortable, "What the core is built for.")
      .value("NEON", InstructionSet::kNeon, "64-bit ARM.")
      .value("SSE42", InstructionSet::kSse42, "x86-64 since 2008.")
      .value("AVX2", InstructionSet::kAvx2, "x86-64 since 2013.")
      .value("AVX512", InstructionSet::kAvx512, "With VPOPCNTDQ and VNNI: x86-64 since 2019.");
  m.def("is_supported", nb::overload_cast<InstructionSet>(&IsSupported), "instruction_set"_a,
        "Whether this processor and this build have the instruction set.");
  m.def("best_instruction_set", &BestInstructionSet, "The best one that is supported.");
}

void BindPackedDescriptors(nb::module_& m) {
  nb::class_<PackedDescriptors>(m, "PackedDescriptors",
                                "The descriptors of one image, prepared for match_packed.")
      .def(
          "__init__",
          [](PackedDescriptors* self, const Descriptors& descriptors,
             const std::optional<Points3>& bearings) {
            if (bearings) {
              new (self) PackedDescriptors(descriptors, *bearings);
            } else {
              new (self) PackedDescriptors(descriptors);
            }
          },
          "descriptors"_a, "bearings"_a = nb::none(),
          "descriptors (N, D) uint8, D at most 1024. bearings (N, 3): rows that are not finite\n"
          "take no part in matching.\n\n"
          "Raises ValueError for longer descriptors or arrays that do not fit.")
      .def("__len__", &PackedDescriptors::size);
}

}  // namespace

void BindMatching(nanobind::module_& m) {
  BindInstructionSet(m);
  BindPackedDescriptors(m);
  m.def(
      "match_descriptors",
      [](const Descriptors& query, const Descriptors& cand, const MatchingOptions& options) {
        return ToRows(MatchDescriptors(query, cand, options));
      },
      "query"_a, "cand"_a, "options"_a, nb::call_guard<nb::gil_scoped_release>(),
      "Brute-force matches (M, 2) of descriptors (N, D) uint8 by OpenCV: rows of both, ascending\n"
      "in the query's.\n\n"
      "Raises ValueError for descriptors of different length or bad options.\n"
      "Source: COVINS-G, section III-B2.");
  m.def(
      "match_packed",
      [](const PackedDescriptors& query, const PackedDescriptors& cand,
         const MatchingOptions& options, std::optional<InstructionSet> instruction_set) {
        return ToRows(
            MatchPacked(query, cand, options, instruction_set.value_or(BestInstructionSet())));
      },
      "query"_a, "cand"_a, "options"_a, "instruction_set"_a = nb::none(),
      nb::call_guard<nb::gil_scoped_release>(),
      "The matches (M, 2) of match_descriptors, many times faster; the same ones with every\n"
      "instruction set, by default the best one.\n\n"
      "Raises ValueError for descriptors of different length, bad options or an instruction set\n"
      "that the processor lacks.");
}

}  // namespace covinz
