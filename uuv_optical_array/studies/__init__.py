"""What a scene, an array and a method are good for, measured."""
