"""What render.py draws with: camera, z-buffer, light, paint."""
