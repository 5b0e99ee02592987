"""A controller designed from recordings alone: actuator, model, noises, observer and weights."""
