// How wrong arguments are refused.
#pragma once

#include <cstdlib>
#include <stdexcept>

namespace vmslam {

/// Refuse an argument. A module for web pages has no exceptions, and ends.
inline void require(bool holds, [[maybe_unused]] const char* what) {
    if (holds) return;
#ifdef __cpp_exceptions
    throw std::invalid_argument(what);
#else
    std::abort();
#endif
}

}  // namespace vmslam
