"""A robot, models and controllers of one's own, beside ssmr_torch and not in it."""
