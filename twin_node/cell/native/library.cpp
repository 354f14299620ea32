// The plain C interface. Nothing throws across it: functions return a Status.
#include "../../native/boundary.h"
#include "cast.h"
#include "sense.h"

#pragma GCC visibility push(default)
extern "C" {

int32_t cell_interface_version() { return cell::kInterfaceVersion; }

int32_t cell_cast(const cell::CastRequest *request) {
  return boundary::guarded([&] { cell::cast(*request); });
}

void cell_sense_colours(const cell::ColourRequest *request) { cell::sense_colours(*request); }

void cell_sense_depth(const cell::DepthRequest *request) { cell::sense_depth(*request); }
}
#pragma GCC visibility pop
