"""Generated worlds: geometry, textures, light, and the camera that looks at them."""
