#!/bin/sh
# The tests of the matching kernels on 64-bit ARM, in emulation: `scripts/neon_tests.sh [FOLDER]`.
#
# Needs g++-aarch64-linux-gnu, qemu-user, libgtest-dev and libeigen3-dev (apt). OpenCV is stood for
# by the definition of a match (core/tests/brute_force_matching.cc).
set -eu
cd "$(dirname "$0")/../core"
build=${1:-build/neon}
gtest=/usr/src/googletest/googletest
mkdir -p "$build"
# shellcheck disable=SC2046
${CXX:-aarch64-linux-gnu-g++} -std=c++17 -O2 -static -Wno-psabi -Iinclude -isystem /usr/include/eigen3 \
  -isystem "$gtest/include" -I"$gtest" -o "$build/matching_tests" \
  src/rig_matching.cc src/filtered_matching.cc src/packed_descriptors.cc src/instruction_set.cc \
  $(ls src/match_kernels_*.cc) tests/brute_force_matching.cc tests/rig_matching_test.cc \
  "$gtest/src/gtest-all.cc" "$gtest/src/gtest_main.cc" -lpthread
exec ${EMULATOR-qemu-aarch64} "$build/matching_tests"
