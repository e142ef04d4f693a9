"""Sound cards: one as the board that drives actuators, one as the converter of a sensor."""
