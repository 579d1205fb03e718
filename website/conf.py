"""How Sphinx builds the site. ``website.build`` lays out the pages and calls it."""

project = "skinbake"
author = "the authors of skinbake"
project_copyright = "the authors of skinbake, MIT licence"

extensions = ["myst_parser"]
myst_heading_anchors = 4
"""Headings have the anchors that a Git host gives them, down to the fourth level."""

html_theme = "furo"
html_title = "skinbake"
html_show_sphinx = False
html_copy_source = False

nitpicky = True
"""A link that leads nowhere is a warning, and ``website.build`` makes warnings errors."""

suppress_warnings = ["misc.highlighting_failure"]
"""The highlighters do not know shader types such as ``float3x3``. The text stands as it is."""
