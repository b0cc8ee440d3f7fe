// Reads a log in the text format of the book (LNPR). The engine knows no files; Python writes them, without the truth:
//
//     log = graphslam.load(graphslam.sample_log_path())
//     graphslam.save(dataclasses.replace(log, true_poses=None, true_landmarks=None), "log.txt")
//
// Lines: `delta DT`, `u t NU OMEGA` (leaves pose t), `x t X Y THETA`, `z t ID RANGE BEARING [PSI]`.
#pragma once

#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>

#include "vmslam/log.hpp"

inline vmslam::Log read_log(const std::string& path) {
    std::ifstream file(path);
    if (!file) throw std::runtime_error(path + " cannot be read");
    vmslam::Log log;
    double dt = 0.0;
    std::size_t poses = 0, number = 0;
    for (std::string text; std::getline(file, text);) {
        std::istringstream line(text);
        std::string tag;
        std::size_t step = 0;
        ++number;
        if (!(line >> tag)) continue;
        if (tag == "delta") {
            line >> dt;
        } else if (tag == "u") {
            vmslam::Control u{0.0, 0.0, dt};
            line >> step >> u.nu >> u.omega;
            log.controls.push_back(u);
        } else if (tag == "x") {
            std::array<double, 3> x{};
            line >> step >> x[0] >> x[1] >> x[2];
            if (poses++ == 0) log.start = x;
        } else if (tag == "z") {
            vmslam::LandmarkSighting seen{};
            line >> seen.step >> seen.landmark >> seen.z.range >> seen.z.bearing;
            if (line && !(line >> seen.z.orientation)) log.oriented = false, line.clear();
            if (line && !(seen.z.range > 0)) throw std::runtime_error(path + " has a range that is not above zero");
            log.sightings.push_back(seen);
        } else {
            line.setstate(std::ios::failbit);
        }
        if (!line) throw std::runtime_error(path + ", line " + std::to_string(number) + ": expected delta, u, x or z");
    }
    if (poses == 0 || dt <= 0.0) throw std::runtime_error(path + " has no poses, or no line delta with the step time");
    // a control after the last pose moves nothing
    if (log.controls.size() + 1 < poses) throw std::runtime_error(path + " has fewer controls than motions");
    log.controls.resize(poses - 1);
    for (const auto& seen : log.sightings)
        if (seen.step >= poses) throw std::runtime_error(path + " has sightings from poses that are not there");
    return log;
}
