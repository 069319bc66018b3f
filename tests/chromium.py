"""Pages in Chromium, for `make test-browser`."""

from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

PHONE, DESK = 390, 1180
HEIGHTS = {PHONE: 844, DESK: 1620}


class Opened:
    """A page, and what its console has said."""

    def __init__(
        self, browser: Browser, path: Path, width: int = DESK, scheme: Any = "light"
    ) -> None:
        context = browser.new_context(
            viewport={"width": width, "height": HEIGHTS[width]}, color_scheme=scheme, offline=True
        )
        self.page: Page = context.new_page()
        self.said: list[str] = []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.goto(path.as_uri())

    def text(self, selector: str) -> str:
        return self.page.locator(selector).inner_text()
