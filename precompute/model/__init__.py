"""The beam, its actuators and its fingers: matrices, responses, modes."""
