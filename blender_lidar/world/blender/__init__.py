"""The world as Blender objects, both ways: built from a frame of traffic, and read back as triangles.

Works in the bpy module and in a real Blender, from 3.4 on. Importing a module of this room imports bpy.
"""
