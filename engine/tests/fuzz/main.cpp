// Solves, online loops and particle filters on inputs that follow from a seed: make engine-fuzz. Sanitizers look for errors.
//
// vmslam_fuzz COUNT [FIRST]: the inputs FIRST to FIRST + COUNT - 1. An error names the input, which `vmslam_fuzz 1 INPUT`
// repeats.
#include <sanitizer/common_interface_defs.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>

#include "input.hpp"

namespace {

unsigned long current = 0;
int failures = 0;
/// No input takes longer than a second or two; one that does not end is an error.
constexpr unsigned most_seconds = 60;

void name_input() { std::fprintf(stderr, "input %lu: repeat it with vmslam_fuzz 1 %lu\n", current, current); }

void end_late(int) {
    std::fprintf(stderr, "an input did not end within %u s\n", most_seconds);
    std::abort();
}

}  // namespace

void fuzz::expect(bool holds, const char* what) {
    if (holds) return;
    ++failures;
    std::fprintf(stderr, "FAILED: %s\n", what);
    name_input();
}

int main(int argc, char** argv) {
    const unsigned long count = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 12'000;
    const unsigned long first = argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 0;
    __sanitizer_set_death_callback(name_input);
    std::signal(SIGABRT, [](int) { name_input(); });
    std::signal(SIGALRM, end_late);
    for (current = first; current < first + count; ++current) {
        alarm(most_seconds);
        fuzz::Input input(current);
        switch (current % 3) {
            case 0: fuzz::fuzz_solve(input); break;
            case 1: fuzz::fuzz_online(input); break;
            default: fuzz::fuzz_filter(input);
        }
    }
    std::printf("%lu inputs, %d failures\n", count, failures);
    return failures == 0 ? 0 : 1;
}
