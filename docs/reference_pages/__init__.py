"""The pages of the reference, by what they are made of."""
