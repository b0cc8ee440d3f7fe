#pragma once

#include <stdexcept>

/// Count a failure, and print it, where something does not hold.
void expect(bool holds, const char* what, unsigned seed);

void test_association();
void test_gibbs();
void test_graduated();
void test_linearized();
void test_numbers();
void test_online();
void test_particles();
void test_start();

/// Whether a call throws std::invalid_argument.
template <class Call>
bool refused(Call call) {
    try {
        call();
    } catch (const std::invalid_argument&) {
        return true;
    }
    return false;
}
