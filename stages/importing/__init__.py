"""Import of Mitsuba scenes from elsewhere: `gpf scene import`.

``sources`` finds and unpacks the scene file, ``checks`` checks its XML, ``report`` traces photons
and collects facts, ``description`` puts them into words, ``importer`` calls all of these in order.
``preview`` draws the views.
"""
