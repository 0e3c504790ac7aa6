"""Import of Mitsuba scenes from elsewhere: `gpf scene import`.

``sources`` finds and unpacks the scene file, ``checks`` checks its XML, ``placement`` makes views,
``view_checks`` finds their faults, ``report`` traces photons and collects facts, ``description``
puts them into words, and ``importer`` calls all of these in order. ``preview`` draws the views.
"""
