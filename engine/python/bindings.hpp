// A namespace for each file of bindings: several of them are compiled as one.
#pragma once

#include <nanobind/nanobind.h>

/// use(name) for each file.
#define VMSLAM_BINDINGS(use) \
    use(association) use(certificate) use(edges) use(factors) use(filters) use(gibbs) use(online) use(sparse) use(solve)

#define VMSLAM_DECLARE(name)                    \
    namespace vmslam::python::name##_bindings { \
        void bind(nanobind::module_ & module);  \
    }
VMSLAM_BINDINGS(VMSLAM_DECLARE)
