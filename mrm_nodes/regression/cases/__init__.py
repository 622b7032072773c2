"""What is drawn and judged: images, materials, clouds of configurations; and the images that are kept of them."""
