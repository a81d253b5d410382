"""What strangers' texts may do to a page: nothing."""

from kinectbench.core.pages import environment


def test_texts_of_strangers_steer_nothing() -> None:
    template = environment().from_string("{{ text }}|{{ number }}|{{ packaged('core/page.css')[:3] }}")
    lines = "a\tb\nσ 🪑 ä"
    shown = template.render(text=f"\x1b[31m<b>\u202e{lines}\r\x00", number=0.5)
    assert shown.startswith(f"?[31m&lt;b&gt;?{lines}??|0.5|")
