"""Designs a controller from recordings alone: actuator, model, noises, observer and weights."""
