"""Effect files of other makers (.haptic, .ahap, .hjif) as effects, with a report of what becomes of every event."""
