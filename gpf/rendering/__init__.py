"""The Mitsuba plugins `sppm` and `gpf`, adaptive samples, recording."""
