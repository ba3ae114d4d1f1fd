from typing import Any

Conversion: Any
