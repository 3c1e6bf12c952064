"""The only code that imports bpy (GPL); it runs in a process of its own, started by `datagen.pictures.renderer`."""
