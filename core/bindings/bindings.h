// Each bindings/*.cc binds one subject of the core; core.cc calls them all.
#pragma once

#include <nanobind/nanobind.h>

namespace covinz {

void BindFastLoop(nanobind::module_& m);
void BindLoopGeometry(nanobind::module_& m);
void BindMatching(nanobind::module_& m);  // after BindLoopGeometry, whose MatchingOptions it takes
void BindOdometry(nanobind::module_& m);
void BindPlaceRecognition(nanobind::module_& m);
void BindPoseGraph(nanobind::module_& m);
void BindRigNeighbours(nanobind::module_& m);  // after BindLoopGeometry and BindOdometry

}  // namespace covinz
