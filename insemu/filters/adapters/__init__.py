"""Filters of other programs under :class:`~insemu.filters.protocol.NavigationFilter`: one file each, which is found by being here.

A file ``name.py`` has a class ``Adapter``, which a scenario names (``filter: name``) and ``insemu referee name`` judges. What it imports is an
optional extra of the same name.
"""
