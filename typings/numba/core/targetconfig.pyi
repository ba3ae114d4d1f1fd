from typing import Any

ConfigStack: Any
TargetConfig: Any
