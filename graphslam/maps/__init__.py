"""Maps in use: what is known of landmarks, and where a robot is among them (design, section 7). It knows no graphs."""
