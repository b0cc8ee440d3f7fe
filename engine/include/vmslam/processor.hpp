// The vectors of the processor for which this is compiled. How they are aligned, passed and returned depends on it, so that
// the library and whoever includes its headers must be compiled for the same one.
#pragma once

/// The numbers in a register.
#if defined(__AVX512F__)
#define VMSLAM_REGISTER 8
#elif defined(__AVX__)
#define VMSLAM_REGISTER 4
#else
#define VMSLAM_REGISTER 2
#endif

#if defined(VMSLAM_BUILT_REGISTER) && VMSLAM_BUILT_REGISTER != VMSLAM_REGISTER
#error "vmslam was compiled for other vectors: compile both without -march, or configure vmslam with -DVMSLAM_NATIVE=ON"
#endif
