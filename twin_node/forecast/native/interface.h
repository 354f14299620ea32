// What crosses the plain C boundary: these structs are mirrored field by field in kernel_requests.py and part_requests.py.
#pragma once

#include <cstdint>

#include "part_requests.h"
#include "voxel_requests.h"

namespace forecast {

constexpr int32_t kInterfaceVersion = 35;

constexpr int32_t kOutside = 2;  // beside `boundary::Status`

}  // namespace forecast
