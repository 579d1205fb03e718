"""Hostile input for skinbake: damaged models, arrays and streams, faults, and what must hold of each run.

``python -m fuzz`` runs mutated models through every command, ``python -m fuzz.replay`` one case again,
``python -m fuzz.native`` the compiled loops and decoders under sanitizers, ``python -m fuzz.faults`` injects
signals and I/O errors, ``python -m fuzz.branches`` tells which branches of the readers are reached.
"""
