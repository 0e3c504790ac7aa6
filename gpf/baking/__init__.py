"""A field's light on surfaces as light maps or vertex colours, for engines and pages."""
