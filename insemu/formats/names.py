"""Names of columns in other languages, as the English words by which columns are known."""

from __future__ import annotations

import re
import unicodedata

#: English word -> words of other languages, without accents, in lower case; longer ones go first.
_WORDS: dict[str, str] = {
    "angular velocity": "drehrate drehgeschwindigkeit winkelgeschwindigkeit vitesse_angulaire velocidad_angular velocidade_angular velocita_angolare "
    "hoeksnelheid vinkelhastighet predkosc_katowa "
    " 角速度 陀螺仪 陀螺 ジャイロ угловая_скорость гироскоп 각속도 giroscopio giroscopo gyroskop gyroscoop zyroskop",
    "acceleration": "beschleunigung acceleration_ aceleracion aceleracao accelerazione versnelling przyspieszenie "
    "acceleratie 加速度 加速度计 加速度計 "
    "ускорение акселерометр 가속도 beschleunigungssensor accelerometre acelerometro accelerometro",
    "time": "zeit zeitstempel temps horodatage tiempo tempo tijd czas 时间 時間 時刻 时间戳 время 시간",
    "latitude": "breite breitengrad latitud latitudine breedtegraad szerokosc 纬度 緯度 широта 위도",
    "longitude": "lange laenge langengrad laengengrad longitud longitudine lengtegraad dlugosc 经度 経度 долгота 경도",
    "altitude": "hohe hoehe altitud altura quota hoogte wysokosc 高度 высота 고도 elevacion",
    "speed": "geschwindigkeit vitesse velocidad velocidade velocita snelheid predkosc 速度 скорость 속도",
    "course": "kurs cap rumbo rotta koers richtung 航向 針路 курс",
    "temperature": "temperatur temperatura temperatuur 温度 температура 온도",
}
_ENGLISH = sorted(
    ((word.replace("_", " ").strip(), english) for english, words in _WORDS.items() for word in words.split()),
    key=lambda pair: -len(pair[0]),
)


def english(name: str) -> str:
    """The name with words of other languages turned into English; an English name stays as it is.

    >>> english("Drehrate X"), english("Vitesse angulaire z"), english("gyro_x")
    ('angular velocity X', 'angular velocity z', 'gyro_x')
    """
    plain = unicodedata.normalize("NFKD", name)
    plain = "".join(c for c in plain if not unicodedata.combining(c)).replace("ß", "ss").replace("ł", "l")
    low = plain.lower().replace("_", " ")
    for word, wanted in _ENGLISH:
        if word not in low:
            continue
        edge = r"(?<![a-z])" if word.isascii() else ""
        close = r"(?![a-z])" if word.isascii() else ""
        found = re.search(f"{edge}{re.escape(word)}{close}", low)
        if found is not None:
            return (
                f"{plain[: found.start()]}{wanted}{plain[found.end() :]}"
                if word.isascii()
                else f"{low[: found.start()]}{wanted} {low[found.end() :]}".strip()
            )
    return name
