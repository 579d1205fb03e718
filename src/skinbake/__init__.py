"""Bake skin-weight gradients into glTF files, for correct lighting on skinned characters.

After Tarini, Panozzo, Sorkine-Hornung, *Accurate and Efficient Lighting for Skinned Models*,
Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330.
"""

__version__ = "0.1.0"
