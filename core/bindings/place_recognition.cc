#include "bindings.h"

namespace covinz {

void BindPlaceRecognition(nanobind::module_&) {}

}  // namespace covinz
