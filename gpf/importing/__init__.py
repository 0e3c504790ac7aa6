"""Somebody else's Mitsuba scene becomes a scene of the project: `gpf scene import`.

``sources`` finds and unpacks it, ``checks`` reads the XML, ``sensors`` and ``placement`` make its
views, ``report`` finds out what photon mapping makes of it, ``description`` says so, and
``importer`` does all of that in order.
"""
