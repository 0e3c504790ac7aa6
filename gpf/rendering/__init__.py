"""The Mitsuba plugins `sppm` and `gpf`, adaptive sampling, and recorded frames."""
