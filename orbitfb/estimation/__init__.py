"""Steps of the readings, their noise, and evidence: what the learner and the diagnosis stand on."""
