"""What a browser would see of a page."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Text, elements, names of attributes and addresses of a page."""

    def __init__(self, page: str):
        super().__init__()
        self.text = ""
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.addresses: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        self.addresses += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.text += data
