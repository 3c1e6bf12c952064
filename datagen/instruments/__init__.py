"""Parametric CAD of a femoral-nailing instrument set: nine parts, how they mount together, and a BOP writer.

All drawings are in metres. The mounted set shares one frame: z runs up the nail axis (proximal), x points
sideways to the aiming arm (lateral), y points forwards (anterior); the origin is the centre of the nail's
proximal end face.
"""
