/PROG  GROUPS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 7;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,1,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1] 100% FINE ;
   2:L P[2] 60cm/min CNT100 COORD ;
   3:L P[3] 60cm/min CNT100 ;
   4:J P[4] 100% FINE ;
   5:J P[5] 100% FINE COORD ;
   6:J P[6] 100% FINE ;
   7:J P[7] 100% FINE ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   928.108  mm,	Y =    88.383  mm,	Z =   316.297  mm,
	W =   156.348 deg,	P =    -1.933 deg,	R =    48.192 deg,
	E1=     0.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    90.000 deg,	J2=     0.000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   910.824  mm,	Y =  -357.569  mm,	Z =   155.835  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg,
	E1=     0.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    45.000 deg,	J2=    10.000 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   689.361  mm,	Y =   289.308  mm,	Z =   461.918  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =   -13.117 deg,
	E1=   250.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    90.000 deg,	J2=     0.000 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,	
	J1=     5.000 deg,	J2=    30.000 deg,	J3=   -35.000 deg,
	J4=   -30.000 deg,	J5=   -45.000 deg,	J6=    10.000 deg,
	E1=   250.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    90.000 deg,	J2=     0.000 deg
};
P[5]{
   GP1:
	UF : 0, UT : 1,	
	J1=   -40.000 deg,	J2=    12.000 deg,	J3=   -20.000 deg,
	J4=    60.000 deg,	J5=   -75.000 deg,	J6=   150.000 deg,
	E1=     0.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    30.000 deg,	J2=     5.000 deg
};
P[6]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   846.285  mm,	Y =   284.900  mm,	Z =   229.174  mm,
	W =   169.207 deg,	P =   -11.566 deg,	R =   -97.812 deg,
	E1= ********  mm
   GP2:
	UF : 0, UT : 1,	
	J1=    90.000 deg,	J2=     0.000 deg
};
P[7]{
   GP2:
	UF : 0, UT : 1,	
	J1=    10.000 deg,	J2=     0.000 deg
};
/END
