"""Labels in a figure, and whether they lie apart."""

from matplotlib.text import Annotation


def number_boxes(axes):
    """Return numbers of points and their boxes, without the lines that lead to them."""
    notes = [note for note in axes.texts if isinstance(note, Annotation)]
    numbers = [note for note in notes if note.get_text().isdigit()]
    return [(note, note.get_bbox_patch().get_window_extent()) for note in numbers]


def assert_apart(labels):
    """Compare the boxes of labels, pairs of both."""
    assert labels
    for i, (one, box) in enumerate(labels):
        for other, another in labels[:i]:
            assert not box.overlaps(another), (one.get_text(), other.get_text())
