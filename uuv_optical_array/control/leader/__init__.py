"""What a follower believes of its leader's motion and lamp."""
