#pragma once

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
