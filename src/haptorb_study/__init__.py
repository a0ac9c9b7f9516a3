"""Perceptual studies on the dome: asked, kept, analysed and rehearsed.

From a study file (TOML) to the tables a paper needs. Every answered trial is on the disk before the next begins.
"""
