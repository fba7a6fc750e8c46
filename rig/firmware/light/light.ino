// A dimmable light for anisoscope: lines of ASCII at 115200 baud, described byte by byte in docs/interfaces.md.
//
// Any Arduino with PWM. LAMP drives the gate of a logic-level MOSFET or the dimming input of an LED driver;
// SENSE (optional) reads a photodiode or the voltage over a shunt, low-pass filtered, 0 ... full scale at 100 %.
//
// The lamp is off at power-up, after a reset (opening the port resets most boards: DTR), when DTR drops (boards with
// native USB), and when the host has said nothing for WATCHDOG seconds.

const uint8_t LAMP = 9;
const bool HAS_SENSOR = true;
const uint8_t SENSE = A0;
const uint16_t SENSE_AT_FULL = 1023;  // reading of SENSE at 100 %: adjust once
const char SERIAL_NUMBER[] = "L0001";

const uint8_t MAX_LINE = 31;
const uint16_t WATCHDOG_DEFAULT = 10, WATCHDOG_MAX = 600;

char line[MAX_LINE + 1];
uint8_t used = 0;
bool overlong = false;

bool lit = false;
uint8_t level = 100;
uint16_t watchdog = WATCHDOG_DEFAULT;
unsigned long heard = 0;

void apply() {
  analogWrite(LAMP, lit ? (uint16_t)level * 255 / 100 : 0);
}

void complain(uint8_t code, const char *text) {
  Serial.print(F("ERR "));
  Serial.print(code);
  Serial.print(' ');
  Serial.println(text);
}

// A whole number from minimum to maximum and nothing else; -1 otherwise.
int number(const char *text, int minimum, int maximum) {
  long value = 0;
  if (*text == 0) return -1;
  for (; *text; text++) {
    if (*text < '0' || *text > '9') return -1;
    value = value * 10 + (*text - '0');
    if (value > maximum) return -1;
  }
  return value < minimum ? -1 : (int)value;
}

void tellStatus() {
  Serial.print(lit ? F("STATUS ON ") : F("STATUS OFF "));
  Serial.print(level);
  Serial.print(' ');
  if (HAS_SENSOR) {
    // The mean over several periods of the PWM.
    unsigned long sum = 0;
    for (uint8_t i = 0; i < 64; i++) sum += analogRead(SENSE);
    unsigned long percent = (sum * 100 / 64 + SENSE_AT_FULL / 2) / SENSE_AT_FULL;
    Serial.print(percent > 999 ? 999 : percent);
  } else {
    Serial.print('-');
  }
  Serial.print(' ');
  Serial.println(watchdog);
}

void obey() {
  if (strcmp(line, "ID?") == 0) {
    Serial.print(F("ID ANISOLIGHT 1 "));
    Serial.println(SERIAL_NUMBER);
  } else if (strcmp(line, "STATUS?") == 0) {
    tellStatus();
  } else if (strcmp(line, "ON") == 0) {
    lit = true;
    apply();
    Serial.print(F("OK ON "));
    Serial.println(level);
  } else if (strcmp(line, "OFF") == 0) {
    lit = false;
    apply();
    Serial.println(F("OK OFF"));
  } else if (strncmp(line, "LEVEL ", 6) == 0) {
    int value = number(line + 6, 0, 100);
    if (value < 0) return complain(2, "number out of range");
    level = value;
    apply();
    Serial.print(F("OK "));
    Serial.println(line);
  } else if (strncmp(line, "WATCHDOG ", 9) == 0) {
    int value = number(line + 9, 1, WATCHDOG_MAX);
    if (value < 0) return complain(2, "number out of range");
    watchdog = value;
    Serial.print(F("OK "));
    Serial.println(line);
  } else {
    complain(1, "unknown command");
  }
}

void endOfLine() {
  heard = millis();
  if (overlong) {
    complain(3, "line too long");
  } else if (used > 0) {
    line[used] = 0;
    obey();
  }
  used = 0;
  overlong = false;
}

void setup() {
  pinMode(LAMP, OUTPUT);
  apply();
  Serial.begin(115200);
  Serial.println(F("! READY"));
}

void loop() {
  while (Serial.available()) {
    char c = Serial.read();
    if (c == '\n') {
      endOfLine();
    } else if (c != '\r') {
      if (used < MAX_LINE) line[used++] = c;
      else overlong = true;
    }
  }
  if (lit && millis() - heard > 1000UL * watchdog) {
    lit = false;
    apply();
    Serial.println(F("! WATCHDOG"));
  }
#if defined(USBCON)
  // Native USB: the host closed the port, or has gone.
  if (lit && !Serial.dtr()) {
    lit = false;
    apply();
  }
#endif
}
