#include "bindings.h"

namespace covinz {

void BindLoopGeometry(nanobind::module_&) {}

}  // namespace covinz
