"""Noise, biases and misread ids of a robot that nobody has calibrated, from one log without ground truth."""
